"""The triangle wave of a flapping rig."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from labrun.devices import Trajectory


class TriangleGait:
    """Each joint swings at constant speed between plus and minus its amplitude."""

    def __init__(
        self, joints: Mapping[str, Mapping[str, Any]], let: Mapping[str, Any], settings: Mapping[str, Any]
    ) -> None:
        self.joints = tuple(joints)
        self._names = {
            joint: (str(keys["amplitude_deg"]), str(keys["frequency_hz"])) for joint, keys in joints.items()
        }

    def period_s(self, condition: Mapping[str, float | str]) -> float:
        _, frequency = self._names[self.joints[0]]
        return 1 / float(condition[frequency])

    def trajectory(
        self, condition: Mapping[str, float | str], *, duration_s: float, rate_hz: float
    ) -> Trajectory:
        time_s = np.linspace(0, duration_s, max(2, round(duration_s * rate_hz) + 1))
        columns = []
        for joint in self.joints:
            amplitude, frequency = (float(condition[name]) for name in self._names[joint])
            columns.append(
                np.radians(amplitude) * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * frequency * time_s))
            )
        return Trajectory(self.joints, time_s, np.column_stack(columns), self.period_s(condition))
