"""Compiled: one Runge-Kutta step. Importing this imports numba."""

from labrun.compiled import Pointer, inlined
from labrun.models.calling import beyond, few
from labrun.models.slopes import slopes
from labrun.models.system import System


@inlined
def fourth_order(
    t: float, h: float, u: Pointer, inputs: int, now: Pointer, work: Pointer, system: System, loaded: bool
) -> None:
    """Advance `now` by one classical step of length `h`.

    Parameters
    ----------
    u : (3, inputs)
        At start, middle and end of the step.
    work : (at least 3 * states,)
        Begins with the derivatives at the start, where those are known.
    loaded
        See `slopes`: for the start of the step.
    """
    total = system.total
    slope, increment, at = work, beyond(work, total), beyond(work, 2 * total)
    for k in range(total):
        few()
        at[k] = now[k]
        increment[k] = 0.0
    for stage in range(4):
        few()
        moment = (stage + 1) // 2  # start, middle, middle, end
        slopes(t + 0.5 * moment * h, at, beyond(u, inputs * moment), slope, system, loaded and stage == 0)
        weight = 1.0 if stage in (0, 3) else 2.0
        reach = 0.5 * h if stage < 2 else h
        for k in range(total):
            few()
            increment[k] += weight * slope[k]
            at[k] = now[k] + reach * slope[k]
    for k in range(total):
        few()
        now[k] += h / 6.0 * increment[k]


@inlined
def fifth_order(  # noqa: PLR0912 - a branch for each stage
    t: float, h: float, u: Pointer, inputs: int, now: Pointer, work: Pointer, system: System, loaded: bool
) -> None:
    """Advance `now` by one step of length `h` of order 5 with 6 stages.

    Its stages lie at quarters of the step, so that it takes two neighbouring steps of `fourth_order` at once: with
    fewer evaluations, and where the motion is smooth with far smaller errors. Butcher, On Runge-Kutta processes of high
    order, J. Austral. Math. Soc. 4 (1964) 179.

    Parameters
    ----------
    u : (2, 3, inputs)
        At start, middle and end of both halves of the step.
    work : (7 * states,)
        Begins with the derivatives at the start, where those are known. Its last part is left with the state in the
        middle of the step, by Hermite's cubic.
    loaded
        See `slopes`: for the start of the step.
    """
    total = system.total
    a, b, c = work, beyond(work, total), beyond(work, 2 * total)
    d, e, f = beyond(work, 3 * total), beyond(work, 4 * total), beyond(work, 5 * total)
    at = beyond(work, 6 * total)
    for k in range(total):
        few()
        at[k] = now[k]
    for stage in range(6):
        few()
        quarter = stage - 1 if stage > 1 else stage  # 0, 1, 1, 2, 3, 4
        moment = quarter if quarter < 3 else quarter + 1  # the middle stands there twice
        slopes(
            t + 0.25 * quarter * h, at, beyond(u, inputs * moment), beyond(work, stage * total), system,
            loaded and stage == 0,
        )  # fmt: skip
        if stage == 0:
            for k in range(total):
                few()
                at[k] = now[k] + h * (a[k] / 4.0)
        elif stage == 1:
            for k in range(total):
                few()
                at[k] = now[k] + h * ((a[k] + b[k]) / 8.0)
        elif stage == 2:
            for k in range(total):
                few()
                at[k] = now[k] + h * (c[k] - 0.5 * b[k])
        elif stage == 3:
            for k in range(total):
                few()
                at[k] = now[k] + h * ((3.0 * a[k] + 9.0 * d[k]) / 16.0)
        elif stage == 4:
            for k in range(total):
                few()
                known = 2.0 * b[k] - 3.0 * a[k] + 12.0 * (c[k] - d[k])
                at[k] = now[k] + h * ((known + 8.0 * e[k]) * (1.0 / 7.0))
        else:
            for k in range(total):
                few()
                known = 7.0 * a[k] + 32.0 * (c[k] + e[k]) + 12.0 * d[k]
                begin = now[k]
                now[k] += h * ((known + 7.0 * f[k]) * (1.0 / 90.0))
                at[k] = 0.5 * (begin + now[k]) + h * ((a[k] - f[k]) / 8.0)
