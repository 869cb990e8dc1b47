"""Compiled: the derivative of a model with force laws at its sites. Importing this imports numba."""

import numpy as np

from labrun.models.calling import call_law, call_model, kernel
from labrun.models.layout import IntArray
from labrun.models.model import FloatArray

_PROBE_S = 1e-4
"""Time over which the rate of a site is followed to find its acceleration where the rate is an expression."""


@kernel
def accelerations(
    t: float,
    state: FloatArray,
    u: FloatArray,
    p: FloatArray,
    site_address: int,
    rate_states: IntArray,
    force: FloatArray,
    slope: FloatArray,
    ahead: FloatArray,
    site: FloatArray,
    result: FloatArray,
) -> None:
    """Write the acceleration at every site to `result`, given the derivative `slope` of the states."""
    for index in range(rate_states.size):
        if rate_states[index] >= 0:
            result[index] = slope[rate_states[index]]
            continue
        for k in range(slope.size):
            ahead[k] = state[k] + _PROBE_S * slope[k]
        call_model(site_address, t, ahead, u, p, force, site)
        forward = site[4 * index + 1]
        for k in range(slope.size):
            ahead[k] = state[k] - _PROBE_S * slope[k]
        call_model(site_address, t, ahead, u, p, force, site)
        result[index] = (forward - site[4 * index + 1]) / (2.0 * _PROBE_S)


@kernel
def solve(matrix: FloatArray, right: FloatArray, size: int) -> None:
    """Solve a small dense system in place by elimination with row pivoting; the solution replaces `right`."""
    for column in range(size):
        pivot = column
        for row in range(column + 1, size):
            if abs(matrix[row, column]) > abs(matrix[pivot, column]):
                pivot = row
        if pivot != column:
            for k in range(size):
                matrix[column, k], matrix[pivot, k] = matrix[pivot, k], matrix[column, k]
            right[column], right[pivot] = right[pivot], right[column]
        for row in range(column + 1, size):
            factor = matrix[row, column] / matrix[column, column]
            for k in range(column, size):
                matrix[row, k] -= factor * matrix[column, k]
            right[row] -= factor * right[column]
    for row in range(size - 1, -1, -1):
        for k in range(row + 1, size):
            right[row] -= matrix[row, k] * right[k]
        right[row] /= matrix[row, row]


@kernel
def couple(
    t: float,
    state: FloatArray,
    u: FloatArray,
    p: FloatArray,
    derivative: int,
    site_address: int,
    rate_states: IntArray,
    laws: IntArray,
    law_sites: IntArray,
    inertial: IntArray,
    offsets: IntArray,
    values: FloatArray,
    state_offsets: IntArray,
    force: FloatArray,
    slope: FloatArray,
    site: FloatArray,
) -> None:
    """Solve laws that depend on acceleration together with the model; `force` holds the other forces on entry.

    The acceleration at the sites is affine in the forces there, and such a law is affine in the acceleration, so that
    a few trial evaluations give a linear system. Arguments as in `slopes`.
    """
    sites = rate_states.size
    probe, ahead = np.empty(4 * sites), np.empty(slope.size)
    free, loaded = np.empty(sites), np.empty(sites)
    response, matrix = np.empty((sites, sites)), np.empty((sites, sites))
    gain, extra = np.zeros(sites), np.zeros(sites)
    call_model(derivative, t, state, u, p, force, slope)
    accelerations(t, state, u, p, site_address, rate_states, force, slope, ahead, probe, free)
    for at in range(sites):
        force[at] += 1.0
        call_model(derivative, t, state, u, p, force, slope)
        accelerations(t, state, u, p, site_address, rate_states, force, slope, ahead, probe, loaded)
        force[at] -= 1.0
        for other in range(sites):
            response[other, at] = loaded[other] - free[other]
    for e in range(laws.size):
        if inertial[e] == 0:
            continue
        at = law_sites[e]
        still = call_law(
            laws[e], t, site[4 * at], site[4 * at + 1], 0.0, site[4 * at + 2], site[4 * at + 3],
            values, offsets[e], state, state_offsets[e], slope, state_offsets[e],
        )  # fmt: skip
        moving = call_law(
            laws[e], t, site[4 * at], site[4 * at + 1], 1.0, site[4 * at + 2], site[4 * at + 3],
            values, offsets[e], state, state_offsets[e], slope, state_offsets[e],
        )  # fmt: skip
        extra[at] += still
        gain[at] += moving - still
    # F = extra + gain * (free + response F)
    for row in range(sites):
        for column in range(sites):
            matrix[row, column] = (1.0 if row == column else 0.0) - gain[row] * response[row, column]
        extra[row] += gain[row] * free[row]
    solve(matrix, extra, sites)
    for at in range(sites):
        force[at] += extra[at]
    call_model(derivative, t, state, u, p, force, slope)
    accelerations(t, state, u, p, site_address, rate_states, force, slope, ahead, probe, loaded)
    for e in range(laws.size):  # internal states of such a law move with the acceleration just found
        if inertial[e] != 0:
            at = law_sites[e]
            call_law(
                laws[e], t, site[4 * at], site[4 * at + 1], loaded[at], site[4 * at + 2], site[4 * at + 3],
                values, offsets[e], state, state_offsets[e], slope, state_offsets[e],
            )  # fmt: skip


@kernel
def slopes(
    t: float,
    state: FloatArray,
    u: FloatArray,
    p: FloatArray,
    derivative: int,
    site_address: int,
    rate_states: IntArray,
    laws: IntArray,
    law_sites: IntArray,
    inertial: IntArray,
    offsets: IntArray,
    values: FloatArray,
    state_offsets: IntArray,
    force: FloatArray,
    slope: FloatArray,
    site: FloatArray,
) -> None:
    """Write the forces at the sites to `force` and the derivative of all states to `slope`.

    Parameters
    ----------
    state, slope : (model states + effect states,)
    site : (4 * sites,)
        Scratch memory: coordinate, rate, load and stiffness of each site.
    """
    for at in range(rate_states.size):
        force[at] = 0.0
    call_model(site_address, t, state, u, p, force, site)
    coupled = False
    for e in range(laws.size):
        if inertial[e] != 0:
            coupled = True
            continue
        at = law_sites[e]
        force[at] += call_law(
            laws[e], t, site[4 * at], site[4 * at + 1], 0.0, site[4 * at + 2], site[4 * at + 3],
            values, offsets[e], state, state_offsets[e], slope, state_offsets[e],
        )  # fmt: skip
    if coupled:
        couple(
            t, state, u, p, derivative, site_address, rate_states,
            laws, law_sites, inertial, offsets, values, state_offsets, force, slope, site,
        )  # fmt: skip
    else:
        call_model(derivative, t, state, u, p, force, slope)
