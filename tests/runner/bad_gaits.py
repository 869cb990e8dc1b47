"""A gait of a third party that loses its numbers."""

import numpy as np

from labrun.devices import Trajectory


class Lost:
    """Not a number from the middle on."""

    def __init__(self, joints, let, settings):
        self.joints = tuple(joints)

    def period_s(self, condition):
        return 1.0

    def trajectory(self, condition, *, duration_s, rate_hz):
        times = np.linspace(0, duration_s, 11)
        angles = np.where(times > duration_s / 2, np.nan, 0.0)[:, None]
        return Trajectory(self.joints, times, angles)


class Timeless(Lost):
    """A cycle whose length is not a number."""

    def period_s(self, condition):
        return float("nan")
