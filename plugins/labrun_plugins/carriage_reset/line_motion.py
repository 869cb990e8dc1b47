"""One move of the line: to a length at constant speed and, after a pull to the start, out again."""

import numpy as np

from labrun.devices import DeviceError, Trajectory
from labrun.errors import LimitExceededError
from labrun_plugins.carriage_reset.settings import CarriageResetSettings

LINE = "line"
"""Stands where a servo's motion names its joint; the trajectory's values are lengths, m, in place of angles."""
_AT_START_M = 1e-3
_SLACK = 1e-9


def check_move(device: str, settings: CarriageResetSettings, to_m: float, speed_m_s: float) -> None:
    """Refuse a move that leaves a limit.

    Raises
    ------
    LimitExceededError
        Beyond the limits of the file, the line's ends, or what the winch can do.
    DeviceError
        Not numbers, or a speed that is not positive.
    """
    if not (np.isfinite(to_m) and np.isfinite(speed_m_s) and speed_m_s > 0):
        raise DeviceError(
            device, f"cannot travel to {to_m:g} m at {speed_m_s:g} m/s; the speed is above zero"
        )
    for excess in settings.limits.travel_excess(to_m, speed_m_s):
        raise LimitExceededError(
            device, f"{excess}; the move was not sent", hint="change trial.carriage, or the device's limits"
        )
    low_m, high_m = settings.travel_m
    if not low_m - _SLACK <= to_m <= high_m + _SLACK:
        raise LimitExceededError(
            device, f"travel to {to_m:g} m leaves {low_m:g} ... {high_m:g} m; the move was not sent"
        )
    if speed_m_s > settings.top_speed_m_s * (1 + _SLACK):
        raise LimitExceededError(
            device,
            f"{speed_m_s:g} m/s is above the {settings.top_speed_m_s:g} m/s its winch can do; the move was not sent",
            hint="lower trial.carriage.return_speed_m_s, or measure the winch and set top_speed_m_s",
        )


def line_motion(settings: CarriageResetSettings, from_m: float, to_m: float, speed_m_s: float) -> Trajectory:
    """Return the line's motion from a length to another at constant speed.

    A move that ends at the start is a pull: with `release`, the carriage is held there for `hold_s`, and then the
    line is paid out as fast as it may.
    """
    low_m, high_m = settings.travel_m
    times_s, lines_m = [0.0], [from_m]

    def go(goal_m: float, speed: float) -> None:
        duration_s = abs(goal_m - lines_m[-1]) / speed
        if duration_s > 0.0:
            times_s.append(times_s[-1] + duration_s)
            lines_m.append(goal_m)

    go(to_m, speed_m_s)
    if settings.release and to_m <= low_m + _AT_START_M:
        times_s.append(times_s[-1] + settings.hold_s)
        lines_m.append(to_m)
        go(high_m, settings.speed_m_s)
    return Trajectory((LINE,), np.array(times_s), np.array(lines_m)[:, None])
