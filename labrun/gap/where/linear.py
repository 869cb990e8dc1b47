"""Compiled: a model linearised along its trajectory. Importing this imports numba."""

import numpy as np

from labrun.arrays import FloatArray
from labrun.models import kernel
from labrun.models.engine import call_model

_TAYLOR = 8
_SQUARING = 0.5
"""Norm of `A dt` up to which the Taylor series of the exponential is taken directly."""


@kernel
def linearise(
    time_s: FloatArray,
    states: FloatArray,
    u: FloatArray,
    p: FloatArray,
    steps: FloatArray,
    forces: FloatArray,
    derivative: int,
    output: int,
    a: FloatArray,
    c: FloatArray,
) -> None:
    """Write the derivatives of slopes and outputs by the states, by central differences.

    Parameters
    ----------
    time_s : (n,), states : (n, k), u : (n, inputs)
    steps : (k,)
        Of the differences.
    forces : (2, k, n, sites)
        At the sites, for each state a step ahead and a step behind.
    a : (n, k, k), c : (n, m, k)
        Written.
    """
    count, size = states.shape
    sites, channels = forces.shape[3], c.shape[1]
    force, row_u = np.zeros(sites + 1), np.zeros(u.shape[1] + 1)
    state, slope, y = np.empty(size), np.empty(size), np.empty(channels)
    for row in range(count):
        for k in range(u.shape[1]):
            row_u[k] = u[row, k]
        for k in range(size):
            state[k] = states[row, k]
        for k in range(size):
            for side in range(2):
                factor = (1.0 - 2.0 * side) / (2.0 * steps[k])
                state[k] = states[row, k] + (1.0 - 2.0 * side) * steps[k]
                for at in range(sites):
                    force[at] = forces[side, k, row, at]
                call_model(derivative, time_s[row], state, row_u, p, force, slope)
                call_model(output, time_s[row], state, row_u, p, force, y)
                for i in range(size):
                    a[row, i, k] = factor * slope[i] + (a[row, i, k] if side == 1 else 0.0)
                for j in range(channels):
                    c[row, j, k] = factor * y[j] + (c[row, j, k] if side == 1 else 0.0)
            state[k] = states[row, k]


@kernel
def transitions(  # noqa: PLR0912 - small matrices, written out
    a: FloatArray, dt: FloatArray, half: FloatArray, whole: FloatArray
) -> None:
    """Write the transition over each half interval and each interval, ``expm(A dt)``, shapes (n, k, k).

    `A` is the mean of both ends of the interval; the exponential is a scaled and squared Taylor series.
    """
    size = a.shape[1]
    matrix, term, following = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    total = np.empty((size, size))
    for row in range(dt.size):
        norm = 0.0
        for i in range(size):
            for j in range(size):
                matrix[i, j] = 0.25 * dt[row] * (a[row, i, j] + a[row + 1, i, j])
                norm = max(norm, size * abs(matrix[i, j]))
        squarings = 0
        while norm > _SQUARING and squarings < 60:
            norm *= 0.5
            squarings += 1
        for i in range(size):
            for j in range(size):
                matrix[i, j] /= 2.0**squarings
                term[i, j] = 1.0 if i == j else 0.0
                total[i, j] = term[i, j]
        for order in range(1, _TAYLOR + 1):
            _multiply(term, matrix, following)
            for i in range(size):
                for j in range(size):
                    term[i, j] = following[i, j] / order
                    total[i, j] += term[i, j]
        for _ in range(squarings):
            _multiply(total, total, following)
            for i in range(size):
                for j in range(size):
                    total[i, j] = following[i, j]
        _multiply(total, total, following)
        for i in range(size):
            for j in range(size):
                half[row, i, j] = total[i, j]
                whole[row, i, j] = following[i, j]


@kernel
def _multiply(left: FloatArray, right: FloatArray, product: FloatArray) -> None:
    size = left.shape[0]
    for i in range(size):
        for j in range(size):
            value = 0.0
            for k in range(size):
                value += left[i, k] * right[k, j]
            product[i, j] = value
