"""Benches whose truth is integrated by scipy, with physics that a model of them lacks."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from labrun.effects import effects
from labrun.fit.dataset import Dataset, FitTrial
from labrun.gap import Options
from labrun.models import Model, parse_model
from labrun.store import SignalInfo

FloatArray = NDArray[np.float64]
Force = Callable[[float, float, float], float]
"""Torque at the hinge, of time, angle and rate."""

PENDULUM = """
name = "pendulum"
states = ["angle", "rate"]
inputs = ["torque"]
[parameters]
inertia   = { value = 1.2e-3, tolerance = 0.03,   unit = "kg m^2" }
gravity   = { value = 0.06,   tolerance = 0.03,   unit = "N m" }
stiffness = { value = 0.068,  tolerance = "free", unit = "N m/rad" }
damping   = { value = 1.0e-3, tolerance = "free", unit = "N m s/rad" }
[equations]
angle = "rate"
rate  = "(torque + force.hinge - stiffness*angle - damping*rate - gravity*sin(angle)) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
stiffness = "stiffness"
load = "gravity*cos(angle)"
[initial]
angle = 0.0
rate = 0.0
"""
TRUE = {"inertia": 1.22e-3, "gravity": 0.0612, "stiffness": 0.075, "damping": 1.3e-3}
CONDITIONS = ((0.02, 0.6), (0.03, 0.9), (0.04, 1.2), (0.03, 1.7), (0.05, 0.8))
"""Amplitude in N m, frequency in Hz."""


def pendulum() -> Model:
    """Return the model as a person at the bench has it."""
    return parse_model(PENDULUM, "pendulum.toml")


@cache
def swing(
    amplitude: float, frequency: float, extra: Force, parameters: tuple[tuple[str, float], ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time, torque and angle of the true pendulum; the same swing is integrated once."""
    true = dict(parameters)
    time_s = np.arange(0.0, 4.0, 1 / 100)
    torque = amplitude * np.sin(2 * np.pi * frequency * time_s)

    def slope(t: float, x: FloatArray) -> list[float]:
        drive = float(np.interp(t, time_s, torque))
        force = drive + extra(t, x[0], x[1]) - true["stiffness"] * x[0] - true["damping"] * x[1]
        return [x[1], (force - true["gravity"] * np.sin(x[0])) / true["inertia"]]

    end = (float(time_s[0]), float(time_s[-1]))
    course = solve_ivp(slope, end, [0.0, 0.0], t_eval=time_s, rtol=1e-7, atol=1e-9, max_step=0.01)
    return time_s, torque, course.y[0]


def nothing(t: float, q: float, v: float) -> float:
    """Return no further torque."""
    return 0.0


def recorded(
    extra: Force = nothing,
    *,
    true: dict[str, float] = TRUE,
    repeats: int = 3,
    noise: float = 0.004,
    seed: int = 1,
    conditions: Sequence[tuple[float, float]] = CONDITIONS,
    seen: Callable[[FloatArray], FloatArray] = lambda angle: angle,
) -> Dataset:
    """Return noisy trials of the true pendulum with a further torque; `seen` is what the sensor makes of the angle."""
    rng = np.random.default_rng(seed)
    trials = []
    for amplitude, frequency in conditions:
        time_s, torque, angle = swing(amplitude, frequency, extra, tuple(true.items()))
        time_s, torque = time_s.copy(), torque.copy()  # some tests spoil them
        condition = {"amplitude_n_m": amplitude, "frequency_hz": frequency}
        for repeat in range(1, repeats + 1):
            measured = seen(angle) + noise * rng.standard_normal(len(angle))
            label = f"{amplitude} N m at {frequency} Hz, repeat {repeat}"
            trials.append(FitTrial(label, condition, repeat, time_s, torque[:, None], measured[:, None]))
    return Dataset(
        "pendulum",
        Path("pendulum"),
        "recording",
        (SignalInfo("torque", "N m", "linear"),),
        (SignalInfo("angle", "rad", "linear"),),
        tuple(trials),
    )


def logged(name: str, given: SignalInfo, seen: SignalInfo, trials: Sequence[FitTrial]) -> Dataset:
    """Return trials of one input and one output as a recording."""
    return Dataset(name, Path(name), "recording", (given,), (seen,), tuple(trials))


@cache
def dry_friction(torque: float) -> Force:
    """Return Coulomb friction, its sign smoothed."""
    return lambda t, q, v: -torque * float(np.tanh(v / 0.02))


def among(*names: str) -> Options:
    """Return options with these effects alone in the library, beside the parameters: a search of a second or two."""
    others = {effect.id for effect in effects()} - set(names)
    return Options(places=False, withhold=tuple(sorted(others)))
