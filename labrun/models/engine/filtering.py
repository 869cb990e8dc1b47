"""Compiled: the filters of inputs and outputs, and what the sites see."""

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import kernel
from labrun.models.engine.calling import call_filter, call_model


@kernel
def _gather(signals: FloatArray, channel: int, piece: FloatArray) -> None:
    piece[0] = signals[channel]
    index = 1
    for k in range(signals.size):
        if k != channel:
            piece[index] = signals[k]
            index += 1


@kernel
def _keep(row: FloatArray, kept: FloatArray) -> None:
    # An assignment of slices would make numba compile its error message, which takes longer than all the rest.
    for k in range(row.size):
        kept[k] = row[k]


@kernel
def filter_inputs(
    u: FloatArray,
    steps_s: FloatArray,
    addresses: IntArray,
    channels: IntArray,
    offsets: IntArray,
    values: FloatArray,
    memory_offsets: IntArray,
    memory: FloatArray,
    started: bool,
) -> None:
    """Send the inputs ``(steps, 3, inputs)`` through their filters, in place; each step is two straight pieces.

    Where a filter's answer is not straight within a piece, the middle is moved so that the mean over the step is right
    (by Simpson's rule, which is how the integrator weighs them): else a delay by a part of a step would be lost.
    """
    before, after, out = np.empty(u.shape[2]), np.empty(u.shape[2]), np.zeros(3)
    for e in range(addresses.size):
        c = channels[e]
        if not started and steps_s.size > 0:
            _gather(u[0, 0], c, before)
            call_filter(addresses[e], before, before, 0.0, values, offsets[e], memory, memory_offsets[e], out)
        for step in range(steps_s.size):
            half = 0.5 * steps_s[step]
            _gather(u[step, 0], c, before)
            _gather(u[step, 1], c, after)
            call_filter(addresses[e], before, after, half, values, offsets[e], memory, memory_offsets[e], out)
            begin, middle, bent = out[0], out[1], out[2]
            out[2] = 0.0
            _gather(u[step, 2], c, before)
            call_filter(addresses[e], after, before, half, values, offsets[e], memory, memory_offsets[e], out)
            u[step, 0, c] = begin
            u[step, 1, c] = 0.5 * (middle + out[0])
            u[step, 2, c] = out[1]
            bent += out[2]
            out[2] = 0.0
            if bent != 0.0:
                mean = 0.25 * (begin + middle + out[0] + out[1]) + 0.5 * bent
                u[step, 1, c] = 0.25 * (6.0 * mean - begin - out[1])


@kernel
def filter_outputs(
    y: FloatArray,
    last: FloatArray,
    steps_s: FloatArray,
    addresses: IntArray,
    channels: IntArray,
    offsets: IntArray,
    values: FloatArray,
    memory_offsets: IntArray,
    memory: FloatArray,
    started: bool,
) -> None:
    """Send the outputs ``(steps + 1, outputs)`` through their filters, in place; they are straight between rows.

    `last` keeps, for each filter, the row before this block as that filter saw it: shape (filters, outputs).
    """
    before, after, out = np.empty(y.shape[1]), np.empty(y.shape[1]), np.empty(3)
    for e in range(addresses.size):
        c = channels[e]
        if not started:
            _keep(y[0], last[e])
            _gather(y[0], c, before)
            call_filter(addresses[e], before, before, 0.0, values, offsets[e], memory, memory_offsets[e], out)
            y[0, c] = out[1]
        for row in range(1, y.shape[0]):
            _gather(last[e], c, before)
            _gather(y[row], c, after)
            _keep(y[row], last[e])
            dt = steps_s[row - 1]
            call_filter(addresses[e], before, after, dt, values, offsets[e], memory, memory_offsets[e], out)
            y[row, c] = out[1]


@kernel
def evaluate_sites(
    address: int,
    time_s: FloatArray,
    states: FloatArray,
    inputs: FloatArray,
    p: FloatArray,
    force: FloatArray,
    filtered: FloatArray,
) -> None:
    """Write the site quantities of every sample to the rows of `found`."""
    state, u, row = np.empty(states.shape[1]), np.empty(inputs.shape[1]), np.empty(filtered.shape[1])
    for n in range(time_s.size):
        for k in range(state.size):
            state[k] = states[n, k]
        for k in range(u.size):
            u[k] = inputs[n, k]
        call_model(address, time_s[n], state, u, p, force, row)
        for k in range(row.size):
            filtered[n, k] = row[k]
