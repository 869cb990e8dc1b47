"""Settings that every simulated bench has."""

from collections.abc import Mapping
from typing import Any, Literal, TypeVar

from pydantic import Field, NonNegativeFloat, ValidationError

from labrun.errors import SpecError
from labrun.toml import Keys

Settings = TypeVar("Settings", bound="BenchSettings")


class HiddenEffect(Keys):
    """An effect that the bench has and its model lacks; values not given are typical of the bench.

    `kind` is that of its site; needed only where sites of two kinds share a name and the effect fits both.
    """

    effect: str
    site: str
    kind: Literal["joint", "body", "input", "output"] | None = None
    values: dict[str, float] = Field(default_factory=dict)


class BenchSettings(Keys):
    """Settings that every bench has.

    Attributes
    ----------
    hide
        Effects that work on the bench, and that nobody tells the model of.
    parameters
        Relative errors: ``{ stiffness = 0.02 }`` makes the bench 2 % stiffer than its documentation says.
    true_parameters
        What parameters really are, SI: ``{ tilt = 0.05 }``, where a share of the documented value would be zero.
    noise
        Factor on everything random; 0 makes the bench exactly repeatable.
    as_modelled
        Leave out what the bench has beyond the model that its experiments name in ``[gap]``, so that `hide` is all
        that this model lacks; and keep the memory of the bench in a form that tells nobody what that is.
    """

    hide: tuple[HiddenEffect, ...] = ()
    parameters: dict[str, float] = Field(default_factory=dict)
    true_parameters: dict[str, float] = Field(default_factory=dict)
    noise: NonNegativeFloat = 1.0
    as_modelled: bool = False


def checked(model: type[Settings], settings: Mapping[str, Any]) -> Settings:
    """Return the settings of a bench. Raises SpecError: all keys that do not hold, at once."""
    try:
        return model.model_validate(dict(settings))
    except ValidationError as error:
        faults = [
            f"rig.scene.{'.'.join(str(part) for part in item['loc'])}: {item['msg']}"
            for item in error.errors()
        ]
        raise SpecError(
            "settings of the simulated bench do not hold: " + "; ".join(faults),
            hint=f"it knows {', '.join(model.model_fields)}",
        ) from error
