"""A bench with hardly any physics, for measuring what surrounds it: a force in proportion to the commanded angle."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.devices import Trajectory

FloatArray = NDArray[np.float64]


class PlainBench:
    """A scene for ``[rig] scene``: the last motion counts, before it and after it the tail stands still."""

    joints = ("tail",)
    signals: Mapping[str, str] = {"force_x": "N"}

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:  # noqa: ARG002 - as every scene
        self._start_s = 0.0
        self._time_s, self._angle_rad = np.zeros(1), np.zeros(1)

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Every condition finds the same bench."""

    def drive(self, joint: str, trajectory: Trajectory, start_s: float) -> None:  # noqa: ARG002 - there is but one
        self._start_s = start_s
        self._time_s, self._angle_rad = trajectory.time_s, trajectory.angle_rad[:, 0]

    def observe(self, signals: Sequence[str], time_s: FloatArray) -> FloatArray:
        """Return 1 N/rad on every axis, shape (n, signals)."""
        angle = np.interp(time_s - self._start_s, self._time_s, self._angle_rad)
        return np.repeat(angle[:, None], len(signals), axis=1)

    def snapshot(self) -> dict[str, Any]:
        return {
            "start_s": self._start_s,
            "time_s": self._time_s[-1:].tolist(),
            "angle": self._angle_rad[-1:].tolist(),
        }

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        self._start_s = snapshot["start_s"]
        self._time_s, self._angle_rad = np.array(snapshot["time_s"]), np.array(snapshot["angle"])

    def truth(self) -> dict[str, float]:
        return {"newton_per_radian": 1.0}
