"""The few lines of URScript that labrun ever sends."""

import math

from labrun_plugins.ur5.line import Pose

BRAKING_M_S2 = 2.0
STOP = f"stopl({BRAKING_M_S2:.1f})\n"
"""A program of one line: it takes the place of the one that runs, and brakes the tool along its path."""
STOP_PROGRAM = "stop program\n"
"""Understood at the primary port: ends the program."""


def move_program(
    target: Pose, *, speed_m_s: float, acceleration_m_s2: float, register: str, watchdog_s: float
) -> str:
    """Return the program of one straight move at constant speed, which ends when the computer falls silent.

    Parameters
    ----------
    target
        Tool pose at the end.
    speed_m_s, acceleration_m_s2
        Of the speed's trapezoid.
    register
        Input that has to be refreshed.
    watchdog_s
        Longest time between two refreshments.

    Raises
    ------
    ValueError
        A number that is not finite, or a name that is no register.
    """
    if not register.isidentifier():
        raise ValueError(f"{register!r} is no input register")
    pose = ", ".join(_number(one) for one in target)
    return (
        "def labrun_move():\n"
        f'  rtde_set_watchdog("{register}", {_number(1.0 / watchdog_s)}, "stop")\n'
        f"  movel(p[{pose}], a={_number(acceleration_m_s2)}, v={_number(speed_m_s)})\n"
        "end\n"
    )


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise ValueError(f"{value} in a program for the arm")
    return f"{value:.9f}"  # never with an exponent
