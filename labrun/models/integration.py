"""Compiled: the Runge-Kutta loop. Importing this imports numba."""

import numpy as np

from labrun.arrays import FloatArray
from labrun.compiled import Pointer, inlined, kernel
from labrun.models.calling import beyond, call_model, few, pointer
from labrun.models.coupling import couple
from labrun.models.layout import IntArray
from labrun.models.slopes import load
from labrun.models.steps import fifth_order, fourth_order
from labrun.models.system import System


@inlined
def _equal(one: Pointer, other: Pointer, count: int) -> bool:
    for k in range(count):
        few()
        if one[k] != other[k]:
            return False
    return True


@inlined
def _keep(values: Pointer, kept: Pointer, count: int) -> bool:
    """Copy values; tell whether all are finite."""
    finite = True
    for k in range(count):
        few()
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
    y = beyond(pointer(outputs), row * width)
    call_model(output, t, state, u, system.p, system.force, y)
    finite = _keep(state, beyond(pointer(states), row * system.total), system.total)
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
    force = beyond(work, 7 * total)
    system = System(
        derivative, site_values, total, sites, law_table.shape[0], coupled,
        pointer(site_table), pointer(law_table), pointer(p), pointer(values),
        force, beyond(force, sites), beyond(force, 5 * sites),
    )  # fmt: skip
    t, step = start_s, 0
    while step <= count:
        begin = pointer(u_last) if step == count else beyond(drive, 3 * inputs * step)
        loaded = False  # whether the forces for this step's beginning are known from its row
        if step % every == 0:
            row = step // every
            seen = beyond(drive, 3 * inputs * step - inputs) if output_at_end and 0 < step < count else begin
            if not _row(row, t, now, seen, work, output, system, states, outputs):
                return row
            loaded = system.laws > 0 and _equal(seen, begin, inputs)
        if step == count:
            break
        h = steps_s[step]
        # inputs jump between samples only, unless a filter lets a jump through late
        double = paired and _equal(beyond(begin, 2 * inputs), beyond(begin, 3 * inputs), inputs)
        if total > 0 and double:
            fifth_order(t, 2.0 * h, begin, inputs, now, work, system, loaded)
        elif total > 0:
            fourth_order(t, h, begin, inputs, now, work, system, loaded)
        t += h
        step += 1
        if double:
            if step % every == 0:
                row, seen, middle = step // every, beyond(begin, 3 * inputs), beyond(work, 6 * total)
                if not _row(row, t, middle, seen, work, output, system, states, outputs):
                    return row
            t += h
            step += 1
    return count // every + 1
