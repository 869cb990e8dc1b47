"""Compiled: the forces at the sites of a model, and its derivative with them."""

from typing import NamedTuple

from labrun.compiled import IntPointer, Pointer, inlined, kernel
from labrun.models.engine.calling import call_law, call_model, no_vectorise, offset

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


@kernel
def has_inertia(site: int, system: System) -> bool:
    """Tell whether a law at a site depends on its acceleration."""
    for e in range(system.site_table[5 * site + 3], system.site_table[5 * site + 4]):
        no_vectorise()
        if system.law_table[5 * e + 2] != 0:
            return True
    return False


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
        for k in range(system.total):
            no_vectorise()
            ahead[k] = state[k] + _PROBE_S * slope[k]
        call_model(system.site_values, t, ahead, u, system.p, system.force, probe)
        forward = probe[4 * index + 1]
        for k in range(system.total):
            no_vectorise()
            ahead[k] = state[k] - _PROBE_S * slope[k]
        call_model(system.site_values, t, ahead, u, system.p, system.force, probe)
        result[index] = (forward - probe[4 * index + 1]) / (2.0 * _PROBE_S)


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
    found: float = call_law(
        law[0], t, here[0], here[1], acceleration, here[2], here[3],
        offset(system.values, law[3]), offset(state, law[4]), offset(slope, law[4]),
    )  # fmt: skip
    return found


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
