"""Compiled: the site quantities at every sample. Importing this imports numba."""

import numpy as np

from labrun.arrays import FloatArray
from labrun.compiled import kernel
from labrun.models.calling import call_model


@kernel
def evaluate(
    address: int,
    time_s: FloatArray,
    states: FloatArray,
    inputs: FloatArray,
    p: FloatArray,
    force: FloatArray,
    found: FloatArray,
) -> None:
    """Write the site quantities of every sample to the rows of `found`."""
    state, u, row = np.empty(states.shape[1]), np.empty(inputs.shape[1]), np.empty(found.shape[1])
    for n in range(time_s.size):
        for k in range(state.size):
            state[k] = states[n, k]
        for k in range(u.size):
            u[k] = inputs[n, k]
        call_model(address, time_s[n], state, u, p, force, row)
        for k in range(row.size):
            found[n, k] = row[k]
