"""A bench without physics, made of what the devices of an experiment drive and feel."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from labrun.devices import FloatArray
from labrun_plugins.simulated.bench import BenchSettings, TowedBench

_FELT = {
    **{f"force_{axis}": "N" for axis in "xyz"}, **{f"torque_{axis}": "N m" for axis in "xyz"}, "force": "N",
}  # fmt: skip
_UNITS = {"x": "m", "y": "m", "z": "m", "wx": "rad/s", "wy": "rad/s", "wz": "rad/s"}


class PlainSettings(BenchSettings):
    """What the experiment's devices drive and feel; filled in from their tables where no scene is named.

    Attributes
    ----------
    joints_deg
        Lowest and highest angle of every joint.
    feels
        Signals that devices look at, besides joints, forces and the carriage's position.
    """

    joints_deg: Mapping[str, tuple[float, float]] = Field(default_factory=dict)
    feels: tuple[str, ...] = ()


class PlainBench(TowedBench):
    """Joints follow their commands within their limits, the carriage travels, everything else is zero.

    Besides the devices' joints there is ``pusher`` (m), what a linear stage drives: the carriage's position as well.

    Signals: each joint (rad), ``position`` of the carriage (m), six axes of force and torque, ``force``, and `feels`;
    what ends in ``_qw`` is one, so that bodies stand upright.
    """

    Settings: ClassVar[type[BenchSettings]] = PlainSettings
    remembered = ("carriage",)

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        table = PlainSettings.model_validate(dict(settings))
        self.joints = (*table.joints_deg, "pusher")
        still = {name: _UNITS.get(name.rpartition("_")[2], "1") for name in table.feels}
        self.signals = {**_FELT, **still, "position": "m", **dict.fromkeys(table.joints_deg, "rad")}
        super().__init__(settings, rng)
        self._ends = {joint: np.radians(ends) for joint, ends in table.joints_deg.items()}

    def truth(self) -> dict[str, Any]:
        """Return that there is nothing to be found."""
        return {"parameters": {}, "parameter_errors": {}, "hidden": []}

    def _advance(self, time_s: FloatArray) -> FloatArray:
        rows = np.zeros((len(time_s), len(self.signals)))
        for name, column in self._columns.items():
            if name in self._ends:
                low, high = self._ends[name]
                rows[:, column] = np.clip(self._drives[name].angles(time_s), low, high)
            elif name == "position":
                pushed = self._drives["pusher"].angles(time_s)
                rows[:, column] = self._carriage.motion(time_s)[0] + pushed
            elif name.endswith("_qw"):
                rows[:, column] = 1.0
        return rows
