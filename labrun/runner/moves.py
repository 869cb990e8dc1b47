"""Smooth moves from pose to pose."""

import math
from collections.abc import Mapping

import numpy as np

from labrun.devices import Trajectory

_PEAK = 1.875
"""Peak speed of a minimum-jerk move, in mean speeds (Flash and Hogan 1985: 10 s^3 - 15 s^4 + 6 s^5)."""

_RATE_HZ = 50.0
_NEGLIGIBLE_RAD = 1e-6


def smooth_move(
    start_rad: Mapping[str, float], goal_rad: Mapping[str, float], speed_rad_s: float
) -> Trajectory | None:
    """Return a minimum-jerk move of some joints, all ending together.

    Parameters
    ----------
    start_rad, goal_rad
        Angle of each joint, rad; joints without a goal are left out.
    speed_rad_s
        Greatest speed any joint may reach.

    Returns
    -------
    Trajectory or None
        None if there is nothing to move. Between two poses inside their limits the whole move is inside: every
        joint's angle is monotone.
    """
    joints = tuple(joint for joint in goal_rad if joint in start_rad)
    start = np.array([start_rad[joint] for joint in joints])
    goal = np.array([goal_rad[joint] for joint in joints])
    farthest = float(np.max(np.abs(goal - start), initial=0.0))
    if farthest < _NEGLIGIBLE_RAD:
        return None
    # The straight pieces between points are never steeper than the curve; the margin covers rounding alone.
    duration_s = _PEAK * farthest / speed_rad_s * (1 + 1e-9)
    share = np.linspace(0.0, 1.0, max(3, math.ceil(duration_s * _RATE_HZ) + 1))
    course = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return Trajectory(joints, share * duration_s, start + course[:, None] * (goal - start))
