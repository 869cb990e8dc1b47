"""Compiled: the Runge-Kutta loop. Importing this imports numba."""

import numpy as np

from labrun.models.calling import call_law, call_model, kernel
from labrun.models.layout import IntArray
from labrun.models.model import FloatArray
from labrun.models.slopes import slopes


@kernel
def _record(row: int, state: FloatArray, y: FloatArray, states: FloatArray, outputs: FloatArray) -> bool:
    finite = True
    for k in range(state.size):
        states[row, k] = state[k]
        finite = finite and np.isfinite(state[k])
    for k in range(y.size):
        outputs[row, k] = y[k]
        finite = finite and np.isfinite(y[k])
    return finite


@kernel
def _inputs_at(
    step: int, steps: int, output_at_end: bool, u: FloatArray, u_last: FloatArray, row_u: FloatArray
) -> None:
    for k in range(u_last.size):
        if step == steps:
            row_u[k] = u_last[k]
        else:
            row_u[k] = u[step - 1, 2, k] if output_at_end and step > 0 else u[step, 0, k]


@kernel
def integrate(  # noqa: PLR0912 - one loop on purpose, see below
    start_s: float,
    steps_s: FloatArray,
    u: FloatArray,
    u_last: FloatArray,
    every: int,
    output_at_end: bool,
    p: FloatArray,
    derivative: int,
    output: int,
    site_address: int,
    rate_states: IntArray,
    laws: IntArray,
    law_sites: IntArray,
    inertial: IntArray,
    offsets: IntArray,
    values: FloatArray,
    state_offsets: IntArray,
    state: FloatArray,
    states: FloatArray,
    outputs: FloatArray,
) -> int:
    """Integrate with classical Runge-Kutta steps; `state` is advanced in place.

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
    states, outputs : (steps // every + 1, ...)
        Written row by row; the first row is the initial state.

    Returns
    -------
    int
        Rows written: fewer than there are when a state or an output stops being finite.
    """
    total, sites, count, inputs = state.size, rate_states.size, steps_s.size, u_last.size
    slope, increment, at = np.empty(total), np.empty(total), np.empty(total)
    force = np.zeros(max(sites, 1))[:sites]
    site = np.empty(4 * sites + 1)
    row_u, y = np.empty(inputs), np.empty(outputs.shape[1])
    # Without a law that depends on acceleration, what `slopes` does stands here in line: numba counts a reference to
    # each array on every call of it, which would take longer than the laws themselves.
    coupled = inertial.size > 0 and inertial.max() != 0
    t = start_s
    for step in range(count + 1):
        if step % every == 0:
            row = step // every
            _inputs_at(step, count, output_at_end, u, u_last, row_u)
            if coupled:  # outputs may show the forces at the sites
                slopes(
                    t, state, row_u, p, derivative, site_address, rate_states,
                    laws, law_sites, inertial, offsets, values, state_offsets, force, slope, site,
                )  # fmt: skip
            elif laws.size > 0:
                for k in range(sites):
                    force[k] = 0.0
                call_model(site_address, t, state, row_u, p, force, site)
                for e in range(laws.size):
                    k = law_sites[e]
                    force[k] += call_law(
                        laws[e], t, site[4 * k], site[4 * k + 1], 0.0, site[4 * k + 2], site[4 * k + 3],
                        values, offsets[e], state, state_offsets[e], slope, state_offsets[e],
                    )  # fmt: skip
            call_model(output, t, state, row_u, p, force, y)
            if not _record(row, state, y, states, outputs):
                return row
        if step == count:
            break
        h = steps_s[step]
        for k in range(total):
            at[k] = state[k]
            increment[k] = 0.0
        for stage in range(4 if total > 0 else 0):
            moment = (stage + 1) // 2  # start, middle, middle, end
            for k in range(inputs):
                row_u[k] = u[step, moment, k]
            if laws.size == 0:
                call_model(derivative, t + 0.5 * moment * h, at, row_u, p, force, slope)
            elif not coupled:
                for k in range(sites):
                    force[k] = 0.0
                call_model(site_address, t + 0.5 * moment * h, at, row_u, p, force, site)
                for e in range(laws.size):
                    k = law_sites[e]
                    force[k] += call_law(
                        laws[e], t + 0.5 * moment * h, site[4 * k], site[4 * k + 1], 0.0,
                        site[4 * k + 2], site[4 * k + 3],
                        values, offsets[e], at, state_offsets[e], slope, state_offsets[e],
                    )  # fmt: skip
                call_model(derivative, t + 0.5 * moment * h, at, row_u, p, force, slope)
            else:
                slopes(
                    t + 0.5 * moment * h, at, row_u, p, derivative, site_address, rate_states,
                    laws, law_sites, inertial, offsets, values, state_offsets, force, slope, site,
                )  # fmt: skip
            weight = 1.0 if stage in (0, 3) else 2.0
            reach = 0.5 * h if stage < 2 else h
            for k in range(total):
                increment[k] += weight * slope[k]
                at[k] = state[k] + reach * slope[k]
        for k in range(total):
            state[k] += h / 6.0 * increment[k]
        t += h
    return count // every + 1
