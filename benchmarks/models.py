"""The compiled models beside scipy's odeint on the same equations, at equal error.

    python benchmarks/models.py [--repeats 7]

Three cases: the shipped hinge pendulum released at 60 deg; the same with three effects attached (quadratic
drag, cubic stiffness, viscous damping); a driven pendulum whose torque is given by samples, linear between
them, 10 s at 100 Hz each.

The reference is DOP853 at rtol 1e-12, atol 1e-14, restarted at every sample, where the torque has its kinks.
The error is the greatest deviation of the angle from it. labrun integrates with the steps that
`suggest_substeps` finds; odeint with the loosest tolerance (rtol = atol, in steps of a factor 10^(1/8)) whose
error is no greater than labrun's, so both are equally good. A time is the whole call with its inputs, as a
fit makes it thousands of times: for labrun that includes laying the torque on the integrator's steps.
Compiling is not counted on either side. odeint's right-hand side is once plain Python, as people write it,
and once compiled by numba (`njit`, called from odeint). The sides take turns; a time is
the CPU time of the one thread either side computes in, and the least of the repeats counts. Goal: at least 20
times faster than odeint with a plain right-hand side.
"""

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from measuring import machine, table
from numpy.typing import NDArray
from scipy.integrate import odeint, solve_ivp

from labrun.effects import AttachedEffect, load_effect
from labrun.models import Model, load_model, parse_model, simulate, suggest_substeps

FloatArray = NDArray[np.float64]
Slope = Callable[..., tuple[float, float]]

ROOT = Path(__file__).resolve().parent.parent
RATE_HZ = 100.0
TIME_S = np.arange(1001) / RATE_HZ
DRAG, CUBIC, VISCOUS = 2e-6, 2e-3, 1e-5
"""Of the effects: N m s^2, N m/rad^3, N m s; each changes the decay by a few per cent."""
DRIVEN = """
name   = "driven-pendulum"
states = ["angle", "rate"]
inputs = { torque = { unit = "N m", between = "linear" } }
[parameters]
inertia        = { value = 1.2e-3, tolerance = 0.03,   unit = "kg m^2" }
gravity_torque = { value = 0.06,   tolerance = 0.03,   unit = "N m" }
stiffness      = { value = 0.068,  tolerance = "free", unit = "N m/rad" }
damping        = { value = 2.9e-4, tolerance = "free", unit = "N m s/rad" }
[equations]
angle = "rate"
rate  = "(torque - stiffness*angle - damping*rate - gravity_torque*sin(angle)) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[initial]
angle = 0.2
rate  = 0.0
"""


@dataclass(frozen=True)
class Case:
    """One trial to simulate: labrun's model, and the same equations for odeint (state, time, further arguments)."""

    name: str
    model: Model
    slope: Slope
    arguments: tuple[object, ...]
    start: tuple[float, float]
    inputs: FloatArray
    effects: tuple[AttachedEffect, ...] = ()


def released(y, _t, inertia, gravity, stiffness, damping):  # type: ignore[no-untyped-def]
    angle, rate = y
    return rate, (-stiffness * angle - damping * rate - gravity * math.sin(angle)) / inertia


def released_with_effects(y, _t, inertia, gravity, stiffness, damping, drag, cubic, viscous):  # type: ignore[no-untyped-def]
    angle, rate = y
    force = -drag * abs(rate) * rate - cubic * angle**3 - viscous * rate
    return rate, (force - stiffness * angle - damping * rate - gravity * math.sin(angle)) / inertia


def driven(y, t, time_s, torque, inertia, gravity, stiffness, damping):  # type: ignore[no-untyped-def]
    angle, rate = y
    u = np.interp(t, time_s, torque)
    return rate, (u - stiffness * angle - damping * rate - gravity * math.sin(angle)) / inertia


def cases() -> list[Case]:
    hinge = load_model(ROOT / "experiments/models/hinge-pendulum.toml")
    pendulum = parse_model(DRIVEN, "driven-pendulum.toml")
    values = [tuple(float(parameter.value) for parameter in model.parameters) for model in (hinge, pendulum)]
    start = (math.radians(60), 0.0)
    none = np.empty((len(TIME_S), 0))
    effects = (
        load_effect("quadratic-drag").attach("hinge", coefficient=DRAG),
        load_effect("cubic-stiffness").attach("hinge", coefficient=CUBIC),
        load_effect("viscous-damping").attach("hinge", coefficient=VISCOUS),
    )
    torque = 0.05 * np.sin(2 * np.pi * 1.4 * TIME_S) + 0.01 * np.sin(2 * np.pi * 3.1 * TIME_S)
    both = (*values[0], DRAG, CUBIC, VISCOUS)
    return [
        Case("hinge, released", hinge, released, values[0], start, none),
        Case("hinge with 3 effects", hinge, released_with_effects, both, start, none, effects),
        Case("driven pendulum", pendulum, driven, (TIME_S, torque, *values[1]), (0.2, 0.0), torque[:, None]),
    ]


def reference(case: Case) -> FloatArray:
    """Return the angle by DOP853, interval by interval, shape (samples,)."""
    state, angle = np.array(case.start), [case.start[0]]
    for begin, end in pairwise(TIME_S):
        solved = solve_ivp(
            lambda t, y: case.slope(y, t, *case.arguments),
            (begin, end),
            state,
            "DOP853",
            rtol=1e-12,
            atol=1e-14,
        )
        state = solved.y[:, -1]
        angle.append(state[0])
    return np.array(angle)


def by_odeint(case: Case, slope: Slope, tolerance: float) -> FloatArray:
    solved: FloatArray = odeint(
        slope, case.start, TIME_S, args=case.arguments, rtol=tolerance, atol=tolerance, mxstep=100_000
    )
    return solved[:, 0]


def by_labrun(case: Case, substeps: int) -> FloatArray:
    result = simulate(
        case.model, TIME_S, case.inputs, initial_state=case.start, effects=case.effects, substeps=substeps
    )
    return result.outputs[:, 0]


def least_s(calls: list[Callable[[], object]], repeats: int) -> list[float]:
    """Return the least time of each call; they take turns, and one time covers 20 ms or more."""
    counts = []
    for call in calls:
        call()
        start = time.thread_time()
        call()
        counts.append(max(1, math.ceil(0.02 / (time.thread_time() - start))))
    best = [math.inf] * len(calls)
    for _ in range(repeats):
        for k, (call, count) in enumerate(zip(calls, counts, strict=True)):
            start = time.thread_time()
            for _ in range(count):
                call()
            best[k] = min(best[k], (time.thread_time() - start) / count)
    return best


def measured(case: Case, repeats: int) -> list[str]:
    import numba

    truth = reference(case)
    compiled = numba.njit(case.slope)
    substeps = suggest_substeps(
        case.model, TIME_S, case.inputs, initial_state=case.start, effects=case.effects
    )
    ours = float(np.abs(by_labrun(case, substeps) - truth).max())
    ladder = 10.0 ** np.arange(-2, -13, -0.125)
    errors = ((float(np.abs(by_odeint(case, compiled, tol) - truth).max()), float(tol)) for tol in ladder)
    theirs, tolerance = next(pair for pair in errors if pair[0] <= ours)
    labrun_s, plain_s, compiled_s = least_s(
        [
            lambda: by_labrun(case, substeps),
            lambda: by_odeint(case, case.slope, tolerance),
            lambda: by_odeint(case, compiled, tolerance),
        ],
        repeats,
    )
    return [
        case.name, f"{substeps}", f"{ours:.1e}", f"{theirs:.1e} (tol {tolerance:.1e})", f"{1e3 * labrun_s:.3f}",
        f"{1e3 * plain_s:.2f}", f"{1e3 * compiled_s:.2f}", f"{plain_s / labrun_s:.0f}", f"{compiled_s / labrun_s:.1f}",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    print(machine("labrun", "numpy", "scipy", "numba"))
    head = [
        "10 s at 100 Hz", "substeps", "error rad", "odeint's error", "labrun ms", "odeint ms", "odeint+numba ms",
        "times faster", "than +numba",
    ]  # fmt: skip
    print(table(head, [measured(case, repeats) for case in cases()]))


if __name__ == "__main__":
    main()
