"""What all simulated benches share: a time grid, commanded joints, hand-made changes, and an exact memory."""

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray, Trajectory
from labrun.effects import AttachedEffect, Scale
from labrun.errors import ExperimentError, SpecError
from labrun.models import Model, Site
from labrun_plugins.simulated.bench.hidden import Passage, described, hidden_effects
from labrun_plugins.simulated.bench.history import (
    ACCELERATION_M_S2,
    Carriage,
    History,
    JointDrive,
    generator_state,
    packed,
    restore_generator,
    sealed,
    unpacked,
    unsealed,
)
from labrun_plugins.simulated.bench.settings import BenchSettings, checked

_SNAPSHOT_SPAN_S = 0.2
"""A restored bench can be looked at from this long before the snapshot on."""
_CHUNK = 20_000
"""Grid points simulated at once, at most: bounds the memory of a long wait."""


class Bench(ABC):
    """A simulated bench on a uniform time grid. Subclasses give `_advance` and its memory.

    Parameters
    ----------
    settings
        The table ``[rig.scene]`` of the experiment file, without ``plugin``.
    rng
        Source of everything random on the bench.
    """

    Settings: ClassVar[type[BenchSettings]] = BenchSettings
    step_s: float = 0.005
    fine_step_s: ClassVar[float | None] = None
    """Step of a bench that has to agree with a model, where `step_s` is too coarse for that."""
    signals: Mapping[str, str]
    joints: tuple[str, ...]
    steps_are_beyond_model: ClassVar[bool] = False
    """Whether frames, steps and dead band of servos show on this bench, and its model has none: see `smooth_drives`."""
    scale: ClassVar[Scale] = Scale()
    """Typical magnitudes on the bench, in which effects without values are hidden."""
    sensed: ClassVar[tuple[str, ...]] = ()
    """Signals whose sensors effects can be hidden in; without any, the outputs of the bench's model."""
    remembered: ClassVar[tuple[str, ...]] = ()
    """Attributes that make up the memory of the subclass, without their underscore: arrays, what JSON knows, and what
    has a snapshot of its own."""
    _model: Model

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        self._settings: Any = checked(self.Settings, settings)
        if self._settings.as_modelled and self.fine_step_s is not None:
            self.step_s = self.fine_step_s
        self._rng = rng
        self._columns = {signal: column for column, signal in enumerate(self.signals)}
        self._drives = {joint: JointDrive() for joint in self.joints}
        self._wanted: dict[tuple[str, ...], NDArray[np.int64]] = {}
        self._history = History(self.step_s, len(self.signals))
        self._began = False

    @property
    def places(self) -> tuple[Site, ...]:
        """Where effects can be hidden from a model of this bench: joints, bodies, and what is sensed."""
        driven = [Site(joint, "input") for joint in self.joints]
        sensed = self.sensed or [output.name for output in self._model.outputs]
        return (*driven, *self._model.sites, *(Site(signal, "output") for signal in sensed))

    @property
    def smooth_drives(self) -> bool:
        """Tell whether servos are to follow what they are told without frames, steps and dead band."""
        return bool(self._settings.as_modelled) and self.steps_are_beyond_model

    def arrange(self, condition: Mapping[str, float | str]) -> None:  # noqa: B027
        """Put in place what a person would change by hand; this bench has nothing of the kind."""

    def drive(self, joint: str, trajectory: Trajectory, start_s: float) -> None:
        """Command one joint from `start_s` on."""
        if joint not in self._drives:
            raise ExperimentError(
                f"this bench has no joint {joint!r}", hint=f"it has {', '.join(self.joints)}"
            )
        self._drives[joint].forget_before(self._history.end * self.step_s)
        self._drives[joint].command(trajectory, start_s)

    def tow(self, from_m: float, to_m: float, speed_m_s: float, start_s: float) -> None:  # noqa: ARG002
        """Move the carriage."""
        raise ExperimentError(
            "this bench has no carriage", hint="leave out trial.carriage, or use another scene"
        )

    def _push(self, joint: str, from_m: float, to_m: float, speed_m_s: float, start_s: float) -> None:
        """Drive the joints along one way at constant speed, for stages that start and stop within a step."""
        way = abs(to_m - from_m)
        if way == 0.0 or speed_m_s <= 0.0:
            path = Trajectory(self.joints, np.zeros(1), np.array([[to_m]]))
        else:
            path = Trajectory(self.joints, np.array([0.0, way / speed_m_s]), np.array([[from_m], [to_m]]))
        self.drive(joint, path, start_s)

    def observe(self, signals: Sequence[str], time_s: FloatArray) -> FloatArray:
        """Return the true signals at ascending times, shape (n, signals)."""
        columns = self._columns_of(tuple(signals))
        if len(time_s) == 0:
            return np.empty((0, len(columns)))
        self._begin(float(time_s[0]))
        need = math.floor(float(time_s[-1]) / self.step_s) + 2
        while self._history.end < need:
            count = min(need - self._history.end, _CHUNK)
            first = self._history.end
            times = np.arange(first, first + count, dtype=np.float64) * self.step_s
            self._history.append(self._advance(times))
        return self._history.at(columns, time_s)

    def _columns_of(self, signals: tuple[str, ...]) -> NDArray[np.int64]:
        known = self._wanted.get(signals)
        if known is None:
            known = np.array([self._columns[signal] for signal in signals], dtype=np.int64)
            self._wanted[signals] = known
        return known

    def snapshot(self) -> dict[str, Any]:
        """Return the whole memory of the bench as JSON-ready values."""
        memory = {
            "began": self._began,
            "history": self._history.snapshot(_SNAPSHOT_SPAN_S),
            "drives": {joint: drive.snapshot() for joint, drive in self._pruned_drives().items()},
            "generator": generator_state(self._rng),
            "memory": self._memory(),
        }
        return sealed(memory) if self._settings.as_modelled else memory

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take back what `snapshot` gave."""
        snapshot = unsealed(snapshot)
        self._began = bool(snapshot["began"])
        self._history.restore(snapshot["history"])
        for joint, stored in snapshot["drives"].items():
            self._drives[joint].restore(stored)
        restore_generator(self._rng, snapshot["generator"])
        self._recall(snapshot["memory"])

    @abstractmethod
    def truth(self) -> dict[str, Any]:
        """Return parameters and hidden effects as JSON-ready values."""

    @abstractmethod
    def _advance(self, time_s: FloatArray) -> FloatArray:
        """Simulate up to the next grid points and return their signals, shape (n, signals)."""

    def _memory(self) -> dict[str, Any]:
        """Return what the subclass remembers, JSON-ready."""
        return {name: _kept(getattr(self, f"_{name}")) for name in self.remembered}

    def _recall(self, memory: Mapping[str, Any]) -> None:
        """Take back what `_memory` gave."""
        for name in self.remembered:
            own, stored = getattr(self, f"_{name}"), memory[name]
            if hasattr(own, "restore"):
                own.restore(stored)
            else:
                setattr(self, f"_{name}", unpacked(stored) if isinstance(own, np.ndarray) else stored)

    def _passage(self, names: tuple[str, ...], scale: Scale | None = None) -> Passage:
        """Return what joints or sensed signals pass through: the effects that hide at them."""
        wanted = [hidden for hidden in self._settings.hide if hidden.site in names]
        return Passage(names, wanted, scale or self.scale, self.step_s)

    def _inside(self) -> list[AttachedEffect]:
        """Return the effects that hide inside the model: all but those that `_passage` is for."""
        elsewhere = (*self.joints, *self.sensed)
        return hidden_effects(
            [hidden for hidden in self._settings.hide if hidden.site not in elsewhere],
            self._model,
            self.scale,
        )

    def _truth(self, hidden: Iterable[AttachedEffect], **bench: Any) -> dict[str, Any]:
        """Return what stands on the bench, its parameters as they are, and hidden effects."""
        return {
            **bench,
            "parameters": self._model.named_values,
            "parameter_errors": dict(self._settings.parameters),
            "hidden": [described(effect) for effect in hidden],
        }

    def _begin(self, time_s: float) -> None:
        """Start the grid one point before the first look; before that nothing happened."""
        if not self._began:
            self._history.restore(
                [math.floor(time_s / self.step_s) - 1, packed(np.empty((0, len(self.signals))))]
            )
            self._began = True

    def _with_errors(self, model: Model) -> Model:
        """Return the model with the parameter errors and values that the settings ask for."""
        values = model.named_values
        for key in ("parameters", "true_parameters"):
            for name in getattr(self._settings, key):
                if name not in values:
                    raise SpecError(
                        f"rig.scene.{key}: this bench has no parameter {name!r}",
                        hint=f"it has {', '.join(values)}",
                    )
        for name, error in self._settings.parameters.items():
            values[name] *= 1.0 + error
        values |= self._settings.true_parameters
        return model.with_values(values)

    def _pruned_drives(self) -> dict[str, JointDrive]:
        for drive in self._drives.values():
            drive.forget_before(self._history.end * self.step_s)
        return self._drives


class TowedBench(Bench):
    """A bench with a carriage, which goes along a line with ramps."""

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._carriage = Carriage()

    def tow(
        self, from_m: float, to_m: float, speed_m_s: float, start_s: float,
        acceleration_m_s2: float = ACCELERATION_M_S2,
    ) -> None:  # fmt: skip
        """Move the carriage from `start_s` on."""
        self._carriage.move(from_m, to_m, speed_m_s, start_s, acceleration_m_s2)


def _kept(value: Any) -> Any:
    if hasattr(value, "snapshot"):
        return value.snapshot()
    return packed(value) if isinstance(value, np.ndarray) else copy.deepcopy(value)
