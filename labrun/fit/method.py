"""The protocol of fit methods: plugins that turn data into estimates with intervals."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar, cast

import numpy as np
from pydantic import BaseModel

from labrun import registry
from labrun.errors import RequestError
from labrun.fit.dataset import DataCheck, unchecked
from labrun.fit.result import FitSummary
from labrun.models import Model
from labrun.toml import Keys, dotted, validate

Note = Callable[[str], None]
"""Told, in a few words, what is being done now."""


def silent(_: str) -> None:
    """Say nothing."""


GROUP = "labrun.fits"


@dataclass(frozen=True, slots=True)
class FitPlan:
    """How to fit: from a run's experiment, or from what lies beside a recording.

    `settings` are those of `method`; of another method, `methods` has its own, over those of `settings` it knows too.
    """

    method: str = "model"
    model: Model | None = None
    signals: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def settings_of(self, method: str) -> dict[str, Any]:
        """Return the settings of a method."""
        shared = {k: v for k, v in self.settings.items() if method == self.method or takes(method, k)}
        return {**shared, **self.methods.get(method, {})}


@dataclass(frozen=True, slots=True)
class FitJob:
    """What to fit.

    Attributes
    ----------
    target
        A recording folder, a run folder or a run.h5.
    rng
        Of starts and resamples.
    more
        Further runs or recordings that belong to the same fit (``--with``).
    model
        The model that was named, if any was.
    signals
        Which recorded channel is which input or output of the model.
    starts
        How many; None is what the method takes by itself.
    note
        Called with what is being done.
    settings_of
        What the experiment of the target says of another fit, for a fit that is made on it.
    check
        Leaves out the trials that cannot be fitted, such as those in which time jumps.
    """

    target: Path
    rng: np.random.Generator
    more: tuple[Path, ...] = ()
    model: Model | None = None
    signals: Mapping[str, str] = field(default_factory=dict)
    starts: int | None = None
    note: Note = silent
    settings_of: Callable[[str], Mapping[str, Any]] = lambda _: {}
    check: DataCheck = unchecked


class FitMethod(Protocol):
    """A way of fitting with its settings."""

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit.

        Raises
        ------
        RequestError
            Data or a model that this way of fitting cannot take.
        FitError
            Nothing can be fitted to these data.
        """
        ...


class FitPlugin(Protocol):
    """The class an entry point of group ``labrun.fits`` names.

    `Settings` is a pydantic model of its keys of ``[fit.settings]`` and ``--set``.
    """

    Settings: type[BaseModel]

    def __call__(self, settings: Any) -> FitMethod:
        """Make the method of its validated settings."""
        ...


OwnKeys = TypeVar("OwnKeys", bound=BaseModel)


class WithSettings(Generic[OwnKeys]):
    """A fit that keeps its settings; a plugin may, but need not, inherit from it."""

    Settings: ClassVar[type[BaseModel]]

    def __init__(self, settings: OwnKeys) -> None:
        self._settings = settings


class NoSettings(Keys):
    """Settings of a fit without keys of its own."""


def is_method(name: str) -> bool:
    """Tell whether a fit of that name is installed."""
    return registry.is_installed(GROUP, name)


def takes(method: str, key: str) -> bool:
    """Tell whether a fit has a setting of that name."""
    return key in cast("FitPlugin", registry.load(GROUP, method)).Settings.model_fields


def make_method(name: str, settings: Mapping[str, Any]) -> FitMethod:
    """Return a way of fitting.

    Raises
    ------
    PluginError
        Unknown, with the nearest name, or one that does not import.
    RequestError
        Settings that do not hold; all of them at once.
    """
    plugin = cast("FitPlugin", registry.load(GROUP, name))
    known, problems = validate(plugin.Settings, dict(settings), ("fit", "settings"))
    if problems or known is None:
        messages = [f"{dotted(item.path)}: {item.message}" for item in problems]
        messages += (
            []
            if settings
            else [f"an experiment says them in [fit.methods.{name}]; labrun plugins names the fits"]
        )
        raise RequestError("\n".join([f"fit {name}: settings that do not hold", *messages]))
    return plugin(known)
