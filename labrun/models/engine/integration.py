"""Compiled: forces at the sites of a model, its derivative with them, Runge-Kutta steps, and the loop over them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import IntPointer, Pointer, inlined, kernel
from labrun.models.engine.calling import call_law, call_model, no_vectorise, offset, pointer

_PROBE_S = 1e-4
"""Time over which the rate of a site is followed to find its acceleration where the rate is an expression."""


class System(NamedTuple):
    """A model with the laws at its sites.

    The functions called through these addresses take pointers anyway; with pointers throughout, no array is handed
    from function to function, at each of which numba would count a reference to it.

    Attributes
    ----------
    derivative, site_values
        Addresses; `site_values` is 0 where every site is read from states and parameters (see `Forces.sites`).
    total
        States, those of the laws included.
    coupled
        Whether a law depends on acceleration.
    site_table : (5 * sites,), law_table : (5 * laws,)
        Rows of `Forces.sites` and `Forces.laws`.
    p, values
        Values of the model and of the laws.
    force : (sites,)
    site : (4 * sites,)
        Coordinate, rate, load and stiffness of each site.
    scratch
        For `couple`; see `labrun.models.layout.Forces.scratch`.
    inputs
        Number of inputs.
    drift : (2 * inputs,)
        Slopes of the inputs in the present step, and room for inputs a moment ahead.
    """

    derivative: int
    site_values: int
    total: int
    sites: int
    laws: int
    coupled: bool
    site_table: IntPointer
    law_table: IntPointer
    p: Pointer
    values: Pointer
    force: Pointer
    site: Pointer
    scratch: Pointer
    inputs: int
    drift: Pointer


@kernel
def has_inertia(site: int, system: System) -> bool:
    """Tell whether a law at a site depends on its acceleration."""
    for e in range(system.site_table[5 * site + 3], system.site_table[5 * site + 4]):
        no_vectorise()
        if system.law_table[5 * e + 2] != 0:
            return True
    return False


@kernel
def _rate_at(
    t: float, later_s: float, index: int, state: Pointer, u: Pointer, slope: Pointer, system: System,
    ahead: Pointer, probe: Pointer,
) -> float:  # fmt: skip
    """Return the rate of a site a moment later, states and inputs moving on with their slopes."""
    moved = offset(system.drift, system.inputs)
    for k in range(system.total):
        no_vectorise()
        ahead[k] = state[k] + later_s * slope[k]
    for k in range(system.inputs):
        no_vectorise()
        moved[k] = u[k] + later_s * system.drift[k]
    call_model(system.site_values, t, ahead, moved, system.p, system.force, probe)
    return probe[4 * index + 1]


@kernel
def accelerations(
    t: float, state: Pointer, u: Pointer, slope: Pointer, system: System, ahead: Pointer, result: Pointer
) -> None:
    """Write the acceleration at sites whose laws ask for it to `result`, given the derivative `slope` of the states.

    `ahead` is scratch memory for the states and, behind them, 4 numbers of each site.
    """
    probe = offset(ahead, system.total)
    for index in range(system.sites):
        no_vectorise()
        if not has_inertia(index, system):
            result[index] = 0.0
            continue
        rate_state = system.site_table[5 * index + 1]
        if rate_state >= 0:
            result[index] = slope[rate_state]
            continue
        forward = _rate_at(t, _PROBE_S, index, state, u, slope, system, ahead, probe)
        backward = _rate_at(t, -_PROBE_S, index, state, u, slope, system, ahead, probe)
        result[index] = (forward - backward) / (2.0 * _PROBE_S)


@kernel
def solve(matrix: Pointer, right: Pointer, size: int) -> None:
    """Solve a small dense system in place by elimination with row pivoting; the solution replaces `right`.

    `matrix` holds its rows one behind the other.
    """
    for column in range(size):
        no_vectorise()
        pivot = column
        for row in range(column + 1, size):
            no_vectorise()
            if abs(matrix[row * size + column]) > abs(matrix[pivot * size + column]):
                pivot = row
        if pivot != column:
            for k in range(size):
                no_vectorise()
                kept = matrix[column * size + k]
                matrix[column * size + k] = matrix[pivot * size + k]
                matrix[pivot * size + k] = kept
            kept = right[column]
            right[column] = right[pivot]
            right[pivot] = kept
        for row in range(column + 1, size):
            no_vectorise()
            factor = matrix[row * size + column] / matrix[column * size + column]
            for k in range(column, size):
                no_vectorise()
                matrix[row * size + k] -= factor * matrix[column * size + k]
            right[row] -= factor * right[column]
    for row in range(size - 1, -1, -1):
        no_vectorise()
        for k in range(row + 1, size):
            no_vectorise()
            right[row] -= matrix[row * size + k] * right[k]
        right[row] /= matrix[row * size + row]


@kernel
def inertial_force(
    t: float, e: int, acceleration: float, state: Pointer, slope: Pointer, system: System
) -> float:
    """Return what law `e` gives at an acceleration of its site; its own states' derivatives go to `slope`."""
    law = offset(system.law_table, 5 * e)
    here = offset(system.site, 4 * law[1])
    force: float = call_law(
        law[0], t, here[0], here[1], acceleration, here[2], here[3],
        offset(system.values, law[3]), offset(state, law[4]), offset(slope, law[4]),
    )  # fmt: skip
    return force


@kernel
def couple(t: float, state: Pointer, u: Pointer, slope: Pointer, system: System) -> None:
    """Solve laws that depend on acceleration together with the model; `force` holds the other forces on entry.

    The acceleration at the sites is affine in the forces there, and such a law is affine in the acceleration, so that
    a few trial evaluations give a linear system. Arguments as in `slopes`.
    """
    sites, force = system.sites, system.force
    free = system.scratch
    loaded, gain, extra = offset(free, sites), offset(free, 2 * sites), offset(free, 3 * sites)
    matrix = offset(free, 4 * sites)
    ahead = offset(matrix, sites * sites)
    call_model(system.derivative, t, state, u, system.p, force, slope)
    accelerations(t, state, u, slope, system, ahead, free)
    for at in range(sites):
        no_vectorise()
        gain[at] = 0.0
        extra[at] = 0.0
    for e in range(system.laws):
        no_vectorise()
        if system.law_table[5 * e + 2] != 0:
            at = system.law_table[5 * e + 1]
            still = inertial_force(t, e, 0.0, state, slope, system)
            extra[at] += still
            gain[at] += inertial_force(t, e, 1.0, state, slope, system) - still
    # F = extra + gain * (free + response F), where a column of the response follows from one more newton at a site
    for at in range(sites):
        no_vectorise()
        if not has_inertia(at, system):  # no further force there, whatever moves
            for row in range(sites):
                no_vectorise()
                matrix[row * sites + at] = 1.0 if row == at else 0.0
            continue
        force[at] += 1.0
        call_model(system.derivative, t, state, u, system.p, force, slope)
        accelerations(t, state, u, slope, system, ahead, loaded)
        force[at] -= 1.0
        for row in range(sites):
            no_vectorise()
            response = loaded[row] - free[row]
            matrix[row * sites + at] = (1.0 if row == at else 0.0) - gain[row] * response
    for row in range(sites):
        no_vectorise()
        extra[row] += gain[row] * free[row]
    solve(matrix, extra, sites)
    for at in range(sites):
        no_vectorise()
        force[at] += extra[at]
    call_model(system.derivative, t, state, u, system.p, force, slope)
    accelerations(t, state, u, slope, system, ahead, loaded)
    for e in range(system.laws):  # internal states of such a law move with the acceleration just found
        no_vectorise()
        if system.law_table[5 * e + 2] != 0:
            inertial_force(t, e, loaded[system.law_table[5 * e + 1]], state, slope, system)


@inlined
def load(t: float, state: Pointer, u: Pointer, slope: Pointer, system: System) -> None:
    """Write `site`, and to `force` what the laws that do not depend on acceleration give.

    The derivatives of those laws' own states are written to `slope`. Arguments as in `slopes`.
    """
    force, site = system.force, system.site
    if system.site_values != 0:
        for at in range(system.sites):
            no_vectorise()
            force[at] = 0.0
        call_model(system.site_values, t, state, u, system.p, force, site)
    else:
        for at in range(system.sites):
            no_vectorise()
            row = offset(system.site_table, 5 * at)
            site[4 * at] = state[row[0]]
            site[4 * at + 1] = state[row[1]]
            site[4 * at + 3] = system.p[row[2]] if row[2] >= 0 else 0.0
    for at in range(system.sites):
        no_vectorise()
        here = offset(site, 4 * at)
        coordinate, rate, carried, stiffness = here[0], here[1], here[2], here[3]
        total = 0.0
        for e in range(system.site_table[5 * at + 3], system.site_table[5 * at + 4]):
            no_vectorise()
            law = offset(system.law_table, 5 * e)
            if law[2] == 0:
                total += call_law(
                    law[0], t, coordinate, rate, 0.0, carried, stiffness,
                    offset(system.values, law[3]), offset(state, law[4]), offset(slope, law[4]),
                )  # fmt: skip
        force[at] = total


@inlined
def slopes(t: float, state: Pointer, u: Pointer, slope: Pointer, system: System, loaded: bool) -> None:
    """Write the forces at the sites to `force` and the derivative of all states to `slope`.

    Parameters
    ----------
    state, slope : (model states + effect states,)
    u : (inputs,)
    loaded
        Whether `force` is right already (and `slope`, where a law depends on acceleration).
    """
    if not loaded and system.laws > 0:
        load(t, state, u, slope, system)
    if not system.coupled:
        call_model(system.derivative, t, state, u, system.p, system.force, slope)
    elif not loaded:
        couple(t, state, u, slope, system)


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
def _equal(first: Pointer, other: Pointer, count: int) -> bool:
    for k in range(count):
        no_vectorise()
        if first[k] != other[k]:
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
    rows: IntArray,
    output_at_end: bool,
    pairs: NDArray[np.bool_],
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
    rows : (rows,)
        The steps at whose beginning a row of `states` and `outputs` is written, from 0 to the number of steps.
    output_at_end
        Whether a row's outputs see the inputs at the end of the step before it, instead of those of the step after it
        (which differ where an input jumps).
    pairs : (steps,)
        Whether a step and the next, of the same length, are taken as one step of order 5 (where no input jumps between
        them); the others are classical ones of order 4.
    derivative, output, site_values, coupled, site_table, law_table
        See `labrun.models.Model`.
    scratch : (numbers,)
        Zeros, as many as `Forces.scratch`.
    states, outputs : (rows, ...)
        Written row by row; the first row is the initial state.

    Returns
    -------
    int
        Rows written: fewer than there are when a state or an output stops being finite.
    """
    total, sites, count, inputs = state.size, site_table.shape[0], steps_s.size, u_last.size
    now, drive, work = pointer(state), pointer(u), pointer(scratch)
    force, drift = offset(work, 7 * total), np.zeros(2 * inputs + 1)
    system = System(
        derivative, site_values, total, sites, law_table.shape[0], coupled,
        pointer(site_table), pointer(law_table), pointer(p), pointer(values),
        force, offset(force, sites), offset(force, 5 * sites), inputs, pointer(drift),
    )  # fmt: skip
    t, step, row = start_s, 0, 0
    while step <= count:
        if coupled and step < count:
            for k in range(inputs):
                no_vectorise()
                at = 3 * inputs * step + k
                drift[k] = (drive[at + 2 * inputs] - drive[at]) / steps_s[step]
        begin = pointer(u_last) if step == count else offset(drive, 3 * inputs * step)
        loaded = False  # whether the forces for this step's beginning are known from its row
        if rows[row] == step:
            seen = offset(drive, 3 * inputs * step - inputs) if output_at_end and 0 < step < count else begin
            if not _row(row, t, now, seen, work, output, system, states, outputs):
                return row
            row += 1
            loaded = system.laws > 0 and _equal(seen, begin, inputs)
        if step == count:
            break
        h = steps_s[step]
        # inputs jump between samples only, unless a filter lets a jump through late; the step after it has no partner
        double = pairs[step] and _equal(offset(begin, 2 * inputs), offset(begin, 3 * inputs), inputs)
        if total > 0 and double:
            fifth_order(t, 2.0 * h, begin, inputs, now, work, system, loaded)
        elif total > 0:
            fourth_order(t, h, begin, inputs, now, work, system, loaded)
        t += h
        step += 1
        if double:
            if rows[row] == step:
                seen, middle = offset(begin, 3 * inputs), offset(work, 6 * total)
                if not _row(row, t, middle, seen, work, output, system, states, outputs):
                    return row
                row += 1
            t += h
            step += 1
    return row
