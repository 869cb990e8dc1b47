"""Simulate a bench with what is hidden in it: adaptively for the truth, in fixed steps for looking around.

All trials go side by side through one integration. It stops and starts anew wherever a signal has a corner or a jump:
at every sample, at every sample plus a delay, and where a mechanism says so.
"""

from itertools import pairwise

import numpy as np
from scipy.integrate import DOP853, RK45

from .bench import Bench
from .plant import FloatArray

RTOL = 1e-9
_ATOL_SHARE = 1e-10
"""Absolute tolerance, in units of a state's own size."""
_MOST_SUBSTEPS = 500
"""A bench that is stiffer than these allow is drawn again."""
_STABLE = 1.5
"""Fastest rate times step that the classical Runge-Kutta method takes with something to spare (its limit is 2.8)."""
_MOST_STEPS = 20000
_SUBSTEPS = 2


class BlewUpError(Exception):
    """The simulation left the finite numbers, or could not go on."""


def adaptive(bench: Bench) -> FloatArray:
    """Return the outputs (outputs, samples, trials), by Dormand and Prince's pairs with error control."""
    corners = bench.corners()
    y = bench.initial()
    states = {round(float(corners[0]), 9): y}
    shape = y.shape
    if y.size == 0:
        return bench.read(bench.time_s, dict.fromkeys((round(float(t), 9) for t in corners), y))
    rough = any(effect.mechanism.rough for effect in bench.hidden)
    solver_class = RK45 if rough else DOP853
    step = float(corners[1] - corners[0])
    size = np.maximum(_sizes(bench, y), 1e-12)
    atol = np.repeat(_ATOL_SHARE * size, shape[1])
    for begin, end in pairwise(corners):
        inside = 0.5 * float(begin + end)

        def rates(t: float, flat: FloatArray, inside: float = inside) -> FloatArray:
            return bench.rates(t, flat.reshape(shape), inside).ravel()

        span = float(end - begin)
        solver = solver_class(
            rates, float(begin), y.ravel(), float(end), first_step=min(step, span), rtol=RTOL, atol=atol
        )
        taken = 0
        while solver.status == "running":
            solver.step()
            taken += 1
            if taken > _MOST_STEPS or solver.status == "failed":
                raise BlewUpError
            # the last step of a piece is cut short by its end and says little about the next
            step = solver.h_abs if solver.status == "running" else max(step, solver.h_abs)
        step = min(max(step, solver.h_abs), 1.0)
        y = solver.y.reshape(shape)
        if not np.all(np.isfinite(y)):
            raise BlewUpError
        states[round(float(end), 9)] = y
    return bench.read(bench.time_s, states)


def _sizes(bench: Bench, y: FloatArray) -> FloatArray:
    """Return the size of each state, from a quick look at where the trials go."""
    largest = np.max(np.abs(y), axis=1)
    for state in march(bench, y).values():
        largest = np.maximum(largest, np.max(np.abs(state), axis=1))
    return np.asarray(largest)


def fixed(bench: Bench) -> FloatArray:
    """Return the outputs by the classical Runge-Kutta method: quick, for refits and for finding sizes."""
    y = bench.initial()
    if y.size == 0:
        return bench.read(bench.time_s, dict.fromkeys((round(float(t), 9) for t in bench.corners()), y))
    return bench.read(bench.time_s, march(bench, y))


def march(bench: Bench, y: FloatArray) -> dict[float, FloatArray]:
    """Return all states at every corner, by Runge-Kutta steps, two a sample or more if stability asks for it."""
    corners = bench.corners()
    usual = float(bench.time_s[1] - bench.time_s[0])
    substeps = max(_SUBSTEPS, int(np.ceil(bench.fastest() * usual / _STABLE)))
    if substeps > _MOST_SUBSTEPS:
        raise BlewUpError
    states = {round(float(corners[0]), 9): y}
    with np.errstate(all="ignore"):
        for begin, end in pairwise(corners):
            t, inside = float(begin), 0.5 * float(begin + end)
            count = max(1, int(np.ceil(substeps * float(end - begin) / usual - 1e-6)))
            h = float(end - begin) / count
            for _ in range(count):
                k1 = bench.rates(t, y, inside)
                k2 = bench.rates(t + 0.5 * h, y + 0.5 * h * k1, inside)
                k3 = bench.rates(t + 0.5 * h, y + 0.5 * h * k2, inside)
                k4 = bench.rates(t + h, y + h * k3, inside)
                y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
                t += h
            states[round(float(end), 9)] = y
    if not np.all(np.isfinite(y)):
        raise BlewUpError
    return states
