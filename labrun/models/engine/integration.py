"""Compiled: Runge-Kutta steps, and the loop over them."""

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import Pointer, inlined, kernel
from labrun.models.engine.calling import call_model, no_vectorise, offset, pointer
from labrun.models.engine.forces import System, couple, load, slopes


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
    slope, increment, at = work, offset(work, total), offset(work, 2 * total)
    for k in range(total):
        no_vectorise()
        at[k] = now[k]
        increment[k] = 0.0
    for stage in range(4):
        no_vectorise()
        moment = (stage + 1) // 2  # start, middle, middle, end
        slopes(t + 0.5 * moment * h, at, offset(u, inputs * moment), slope, system, loaded and stage == 0)
        weight = 1.0 if stage in (0, 3) else 2.0
        reach = 0.5 * h if stage < 2 else h
        for k in range(total):
            no_vectorise()
            increment[k] += weight * slope[k]
            at[k] = now[k] + reach * slope[k]
    for k in range(total):
        no_vectorise()
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
    a, b, c = work, offset(work, total), offset(work, 2 * total)
    d, e, f = offset(work, 3 * total), offset(work, 4 * total), offset(work, 5 * total)
    at = offset(work, 6 * total)
    for k in range(total):
        no_vectorise()
        at[k] = now[k]
    for stage in range(6):
        no_vectorise()
        quarter = stage - 1 if stage > 1 else stage  # 0, 1, 1, 2, 3, 4
        moment = quarter if quarter < 3 else quarter + 1  # the middle stands there twice
        slopes(
            t + 0.25 * quarter * h, at, offset(u, inputs * moment), offset(work, stage * total), system,
            loaded and stage == 0,
        )  # fmt: skip
        if stage == 0:
            for k in range(total):
                no_vectorise()
                at[k] = now[k] + h * (a[k] / 4.0)
        elif stage == 1:
            for k in range(total):
                no_vectorise()
                at[k] = now[k] + h * ((a[k] + b[k]) / 8.0)
        elif stage == 2:
            for k in range(total):
                no_vectorise()
                at[k] = now[k] + h * (c[k] - 0.5 * b[k])
        elif stage == 3:
            for k in range(total):
                no_vectorise()
                at[k] = now[k] + h * ((3.0 * a[k] + 9.0 * d[k]) / 16.0)
        elif stage == 4:
            for k in range(total):
                no_vectorise()
                known = 2.0 * b[k] - 3.0 * a[k] + 12.0 * (c[k] - d[k])
                at[k] = now[k] + h * ((known + 8.0 * e[k]) * (1.0 / 7.0))
        else:
            for k in range(total):
                no_vectorise()
                known = 7.0 * a[k] + 32.0 * (c[k] + e[k]) + 12.0 * d[k]
                begin = now[k]
                now[k] += h * ((known + 7.0 * f[k]) * (1.0 / 90.0))
                at[k] = 0.5 * (begin + now[k]) + h * ((a[k] - f[k]) / 8.0)


@inlined
def _equal(one: Pointer, other: Pointer, count: int) -> bool:
    for k in range(count):
        no_vectorise()
        if one[k] != other[k]:
            return False
    return True


@inlined
def _keep(values: Pointer, kept: Pointer, count: int) -> bool:
    """Copy values; tell whether all are finite."""
    finite = True
    for k in range(count):
        no_vectorise()
        kept[k] = values[k]
        finite = finite and np.isfinite(values[k])
    return finite


@inlined
def _row(
    row: int,
    t: float,
    state: Pointer,
    u: Pointer,
    slope: Pointer,
    output: int,
    system: System,
    states: FloatArray,
    outputs: FloatArray,
) -> bool:
    """Write one row of states and outputs, which may show the forces at the sites; tell whether it is finite."""
    if system.laws > 0:
        load(t, state, u, slope, system)
        if system.coupled:
            couple(t, state, u, slope, system)
    width = outputs.shape[1]
    y = offset(pointer(outputs), row * width)
    call_model(output, t, state, u, system.p, system.force, y)
    finite = _keep(state, offset(pointer(states), row * system.total), system.total)
    return _keep(y, y, width) and finite


@kernel
def integrate(
    start_s: float,
    steps_s: FloatArray,
    u: FloatArray,
    u_last: FloatArray,
    every: int,
    output_at_end: bool,
    paired: bool,
    p: FloatArray,
    derivative: int,
    output: int,
    site_values: int,
    coupled: bool,
    site_table: IntArray,
    law_table: IntArray,
    values: FloatArray,
    scratch: FloatArray,
    state: FloatArray,
    states: FloatArray,
    outputs: FloatArray,
) -> int:
    """Integrate with Runge-Kutta steps; `state` is advanced in place.

    Parameters
    ----------
    steps_s : (steps,)
    u : (steps, 3, inputs)
        Inputs at start, middle and end of each step.
    u_last : (inputs,)
        Inputs at the last output.
    every
        Steps between two rows of `states` and `outputs`.
    output_at_end
        Whether a row's outputs see the inputs at the end of the step before it, instead of those of the step after it
        (which differ where an input jumps).
    paired
        Whether an even step and the next are taken as one step of order 5 (where no input jumps between them); the
        others are classical ones of order 4. The number of steps is even then.
    derivative, output, site_values, coupled, site_table, law_table
        See `labrun.models.system.System`.
    scratch : (numbers,)
        Zeros, as many as `Forces.scratch`.
    states, outputs : (steps // every + 1, ...)
        Written row by row; the first row is the initial state.

    Returns
    -------
    int
        Rows written: fewer than there are when a state or an output stops being finite.
    """
    total, sites, count, inputs = state.size, site_table.shape[0], steps_s.size, u_last.size
    now, drive, work = pointer(state), pointer(u), pointer(scratch)
    force = offset(work, 7 * total)
    system = System(
        derivative, site_values, total, sites, law_table.shape[0], coupled,
        pointer(site_table), pointer(law_table), pointer(p), pointer(values),
        force, offset(force, sites), offset(force, 5 * sites),
    )  # fmt: skip
    t, step = start_s, 0
    while step <= count:
        begin = pointer(u_last) if step == count else offset(drive, 3 * inputs * step)
        loaded = False  # whether the forces for this step's beginning are known from its row
        if step % every == 0:
            row = step // every
            seen = offset(drive, 3 * inputs * step - inputs) if output_at_end and 0 < step < count else begin
            if not _row(row, t, now, seen, work, output, system, states, outputs):
                return row
            loaded = system.laws > 0 and _equal(seen, begin, inputs)
        if step == count:
            break
        h = steps_s[step]
        # inputs jump between samples only, unless a filter lets a jump through late
        double = paired and _equal(offset(begin, 2 * inputs), offset(begin, 3 * inputs), inputs)
        if total > 0 and double:
            fifth_order(t, 2.0 * h, begin, inputs, now, work, system, loaded)
        elif total > 0:
            fourth_order(t, h, begin, inputs, now, work, system, loaded)
        t += h
        step += 1
        if double:
            if step % every == 0:
                row, seen, middle = step // every, offset(begin, 3 * inputs), offset(work, 6 * total)
                if not _row(row, t, middle, seen, work, output, system, states, outputs):
                    return row
            t += h
            step += 1
    return count // every + 1
