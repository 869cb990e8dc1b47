"""Compiled: laws that depend on acceleration, solved together with the model. Importing this imports numba."""

from labrun.compiled import Pointer, kernel
from labrun.models.calling import beyond, call_law, call_model, few
from labrun.models.system import System

_PROBE_S = 1e-4
"""Time over which the rate of a site is followed to find its acceleration where the rate is an expression."""


@kernel
def accelerations(
    t: float, state: Pointer, u: Pointer, slope: Pointer, system: System, ahead: Pointer, result: Pointer
) -> None:
    """Write the acceleration at every site to `result`, given the derivative `slope` of the states.

    `ahead` is scratch memory for the states and, behind them, 4 numbers of each site.
    """
    probe = beyond(ahead, system.total)
    for index in range(system.sites):
        few()
        rate_state = system.site_table[5 * index + 1]
        if rate_state >= 0:
            result[index] = slope[rate_state]
            continue
        for k in range(system.total):
            few()
            ahead[k] = state[k] + _PROBE_S * slope[k]
        call_model(system.site_values, t, ahead, u, system.p, system.force, probe)
        forward = probe[4 * index + 1]
        for k in range(system.total):
            few()
            ahead[k] = state[k] - _PROBE_S * slope[k]
        call_model(system.site_values, t, ahead, u, system.p, system.force, probe)
        result[index] = (forward - probe[4 * index + 1]) / (2.0 * _PROBE_S)


@kernel
def solve(matrix: Pointer, right: Pointer, size: int) -> None:
    """Solve a small dense system in place by elimination with row pivoting; the solution replaces `right`.

    `matrix` holds its rows one behind the other.
    """
    for column in range(size):
        few()
        pivot = column
        for row in range(column + 1, size):
            few()
            if abs(matrix[row * size + column]) > abs(matrix[pivot * size + column]):
                pivot = row
        if pivot != column:
            for k in range(size):
                few()
                kept = matrix[column * size + k]
                matrix[column * size + k] = matrix[pivot * size + k]
                matrix[pivot * size + k] = kept
            kept = right[column]
            right[column] = right[pivot]
            right[pivot] = kept
        for row in range(column + 1, size):
            few()
            factor = matrix[row * size + column] / matrix[column * size + column]
            for k in range(column, size):
                few()
                matrix[row * size + k] -= factor * matrix[column * size + k]
            right[row] -= factor * right[column]
    for row in range(size - 1, -1, -1):
        few()
        for k in range(row + 1, size):
            few()
            right[row] -= matrix[row * size + k] * right[k]
        right[row] /= matrix[row * size + row]


@kernel
def inertial_force(
    t: float, e: int, acceleration: float, state: Pointer, slope: Pointer, system: System
) -> float:
    """Return what law `e` gives at an acceleration of its site; its own states' derivatives go to `slope`."""
    law = beyond(system.law_table, 5 * e)
    here = beyond(system.site, 4 * law[1])
    found: float = call_law(
        law[0], t, here[0], here[1], acceleration, here[2], here[3],
        beyond(system.values, law[3]), beyond(state, law[4]), beyond(slope, law[4]),
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
    loaded, gain, extra = beyond(free, sites), beyond(free, 2 * sites), beyond(free, 3 * sites)
    matrix = beyond(free, 4 * sites)
    ahead = beyond(matrix, sites * sites)
    call_model(system.derivative, t, state, u, system.p, force, slope)
    accelerations(t, state, u, slope, system, ahead, free)
    for at in range(sites):
        few()
        gain[at] = 0.0
        extra[at] = 0.0
    for e in range(system.laws):
        few()
        if system.law_table[5 * e + 2] != 0:
            at = system.law_table[5 * e + 1]
            still = inertial_force(t, e, 0.0, state, slope, system)
            extra[at] += still
            gain[at] += inertial_force(t, e, 1.0, state, slope, system) - still
    # F = extra + gain * (free + response F), where a column of the response follows from one more newton at a site
    for at in range(sites):
        few()
        force[at] += 1.0
        call_model(system.derivative, t, state, u, system.p, force, slope)
        accelerations(t, state, u, slope, system, ahead, loaded)
        force[at] -= 1.0
        for row in range(sites):
            few()
            response = loaded[row] - free[row]
            matrix[row * sites + at] = (1.0 if row == at else 0.0) - gain[row] * response
    for row in range(sites):
        few()
        extra[row] += gain[row] * free[row]
    solve(matrix, extra, sites)
    for at in range(sites):
        few()
        force[at] += extra[at]
    call_model(system.derivative, t, state, u, system.p, force, slope)
    accelerations(t, state, u, slope, system, ahead, loaded)
    for e in range(system.laws):  # internal states of such a law move with the acceleration just found
        few()
        if system.law_table[5 * e + 2] != 0:
            inertial_force(t, e, loaded[system.law_table[5 * e + 1]], state, slope, system)
