"""Free swings by scipy, which shares nothing with labrun's models or integrator."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from labrun.fit.dataset import Dataset, FitTrial
from labrun.store import SignalInfo

FloatArray = NDArray[np.float64]

INERTIA, GRAVITY = 1.2e-3, 0.06
STIFFNESS, DAMPING = 0.0686, 2.886e-4
"""Means of Table 3.2 of the source work; its body is not given, so this one is ours."""
MODEL = """
name = "hinge"
states = ["angle", "rate"]
[parameters]
inertia        = { value = 1.2e-3, tolerance = 0.03,   unit = "kg m^2" }
gravity_torque = { value = 0.06,   tolerance = 0.03,   unit = "N m" }
stiffness      = { value = 0.068,  tolerance = "free", unit = "N m/rad" }
damping        = { value = 2.9e-4, tolerance = "free", unit = "N m s/rad" }
[equations]
angle = "rate"
rate  = "(force.hinge - stiffness*angle - damping*rate - gravity_torque*sin(angle)) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
stiffness = "stiffness"
[initial]
angle = "free"
rate = 0.0
"""
"""The swinging hinge as a model, its parameters as stated."""


def swing(
    release_rad: float,
    *,
    stiffness: float = STIFFNESS,
    damping: float = DAMPING,
    inertia: float = INERTIA,
    gravity: float = GRAVITY,
    duration_s: float = 6.0,
    rate_hz: float = 360.0,
    extra: Callable[[float, float], float] = lambda angle, rate: 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return time and angle of a body that is let go."""
    time_s = np.arange(round(duration_s * rate_hz) + 1) / rate_hz

    def derivative(_: float, state: FloatArray) -> list[float]:
        angle, rate = state
        torque = -stiffness * angle - damping * rate - gravity * np.sin(angle) + extra(angle, rate)
        return [rate, torque / inertia]

    solved = solve_ivp(
        derivative,
        (0.0, time_s[-1]),
        [release_rad, 0.0],
        method="DOP853",
        t_eval=time_s,
        rtol=1e-9,
        atol=1e-11,
    )
    return time_s, solved.y[0]


def dataset_of(swings: Sequence[tuple[FloatArray, FloatArray]], name: str = "swings") -> Dataset:
    """Return swings as trials of one angle."""
    trials = tuple(
        FitTrial(
            f"swing {index}", {"swing": float(index)}, 1, time_s, np.empty((len(time_s), 0)), angle[:, None]
        )
        for index, (time_s, angle) in enumerate(swings)
    )
    return Dataset(name, Path(name), "recording", (), (SignalInfo("angle", "rad"),), trials)
