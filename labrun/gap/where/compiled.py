"""Compiled: Kalman filter, disturbance smoother, linearisation along a trajectory. Importing this imports numba."""

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.models import kernel
from labrun.models.engine import call_model


@kernel
def _entries(several: FloatArray, counts: IntArray, places: IntArray) -> None:
    """Write where the rows of matrices (n, i, k) are not zero in any of them: `counts` (i,), `places` (i, k).

    Equations of motion read few states each, and most of the work is done on zeros otherwise.
    """
    for i in range(several.shape[1]):
        counts[i] = 0
        for k in range(several.shape[2]):
            for row in range(several.shape[0]):
                if several[row, i, k] != 0.0:
                    places[i, counts[i]] = k
                    counts[i] += 1
                    break


@kernel
def disturbed(  # noqa: PLR0912 - a recursion over small matrices, written out
    phi: FloatArray,
    q: FloatArray,
    begin: IntArray,
    c: FloatArray,
    r: FloatArray,
    start: FloatArray,
    still: FloatArray,
    intensity: float,
    series: FloatArray,
    gains: FloatArray,
    variances: FloatArray,
    innovations: FloatArray,
    likelihood: FloatArray,
) -> None:
    """Filter series of residuals with the state started at zero in every unit; channels one after the other.

    Parameters
    ----------
    phi, q : (n, k, k)
        Transition and covariance of what a disturbance of intensity 1 adds, from each sample to the next.
    begin : (n,)
        1 at the first sample of a unit.
    c : (n, m, k), r : (n, m)
        Outputs by states, and variance of the measurement.
    start, still : (k, k)
        Covariance in which a unit begins: per intensity, and besides.
    series : (n, m, b)
    gains : (n, m, k), variances : (n, m), innovations : (n, m, b)
        Written, for `left_over`.
    likelihood : (b,)
        Written: logarithm, without its constant.
    """
    count, channels, size = c.shape
    many = series.shape[2]
    cov, product = np.zeros((size, size)), np.zeros((size, size))
    state, moved = np.zeros((size, many)), np.zeros((size, many))
    z = np.empty(size)
    moves, moved_by = np.empty(size, dtype=np.int64), np.empty((size, size), dtype=np.int64)
    shows, shown_by = np.empty(channels, dtype=np.int64), np.empty((channels, size), dtype=np.int64)
    _entries(phi, moves, moved_by)
    _entries(c, shows, shown_by)
    for b in range(many):
        likelihood[b] = 0.0
    for row in range(count):
        if begin[row] != 0:
            for i in range(size):
                for b in range(many):
                    state[i, b] = 0.0
                for j in range(size):
                    cov[i, j] = intensity * start[i, j] + still[i, j]
        else:
            for i in range(size):
                for j in range(size):
                    product[i, j] = 0.0
                for place in range(moves[i]):
                    k = moved_by[i, place]
                    factor = phi[row - 1, i, k]
                    for j in range(size):
                        product[i, j] += factor * cov[k, j]
            for i in range(size):
                for j in range(i + 1):
                    value = intensity * q[row - 1, i, j]
                    for place in range(moves[j]):
                        k = moved_by[j, place]
                        value += product[i, k] * phi[row - 1, j, k]
                    cov[i, j] = value
                    cov[j, i] = value
            for i in range(size):
                for b in range(many):
                    moved[i, b] = 0.0
                for place in range(moves[i]):
                    k = moved_by[i, place]
                    factor = phi[row - 1, i, k]
                    for b in range(many):
                        moved[i, b] += factor * state[k, b]
            state, moved = moved, state
        for j in range(channels):
            for i in range(size):
                z[i] = 0.0
            for place in range(shows[j]):
                k = shown_by[j, place]
                factor = c[row, j, k]
                for i in range(size):
                    z[i] += factor * cov[k, i]
            variance = r[row, j]
            for b in range(many):
                innovations[row, j, b] = series[row, j, b]
            for place in range(shows[j]):
                k = shown_by[j, place]
                factor = c[row, j, k]
                variance += factor * z[k]
                for b in range(many):
                    innovations[row, j, b] -= factor * state[k, b]
            variances[row, j] = variance
            logarithm = np.log(variance)
            for b in range(many):
                v = innovations[row, j, b]
                likelihood[b] -= 0.5 * (logarithm + v * v / variance)
            for i in range(size):
                gain = z[i] / variance
                gains[row, j, i] = gain
                if gain == 0.0:
                    continue
                for b in range(many):
                    state[i, b] += gain * innovations[row, j, b]
                for k in range(size):
                    cov[i, k] -= gain * z[k]


@kernel
def left_over(  # noqa: PLR0912 - as above
    phi: FloatArray,
    begin: IntArray,
    c: FloatArray,
    r: FloatArray,
    gains: FloatArray,
    variances: FloatArray,
    innovations: FloatArray,
    squares: FloatArray,
) -> None:
    """Write to `squares` (b,) what the smoothed disturbance leaves of each series, in units of the noise.

    Backward recursion of the disturbance smoother (de Jong 1989; Koopman 1993), channel after channel.
    """
    count, channels, size = c.shape
    many = innovations.shape[2]
    back, moved = np.zeros((size, many)), np.zeros((size, many))
    for b in range(many):
        squares[b] = 0.0
    for row in range(count - 1, -1, -1):
        for j in range(channels - 1, -1, -1):
            for b in range(many):
                value = innovations[row, j, b] / variances[row, j]
                for k in range(size):
                    value -= gains[row, j, k] * back[k, b]
                left = r[row, j] * value
                squares[b] += left * left / r[row, j]
                for k in range(size):
                    back[k, b] += c[row, j, k] * value
        if begin[row] != 0:
            for k in range(size):
                for b in range(many):
                    back[k, b] = 0.0
        else:
            for k in range(size):
                for b in range(many):
                    value = 0.0
                    for i in range(size):
                        value += phi[row - 1, i, k] * back[i, b]
                    moved[k, b] = value
            for k in range(size):
                for b in range(many):
                    back[k, b] = moved[k, b]


@kernel
def spread_of(  # noqa: PLR0912 - as above
    phi: FloatArray, q: FloatArray, begin: IntArray, c: FloatArray, start: FloatArray, found: FloatArray
) -> None:
    """Write to `found` (n,) the largest variance of an output that a disturbance of intensity 1 makes."""
    count, channels, size = c.shape
    cov, product = np.zeros((size, size)), np.zeros((size, size))
    for row in range(count):
        if begin[row] != 0:
            for i in range(size):
                for j in range(size):
                    cov[i, j] = start[i, j]
        else:
            for i in range(size):
                for j in range(size):
                    value = 0.0
                    for k in range(size):
                        value += phi[row - 1, i, k] * cov[k, j]
                    product[i, j] = value
            for i in range(size):
                for j in range(size):
                    value = q[row - 1, i, j]
                    for k in range(size):
                        value += product[i, k] * phi[row - 1, j, k]
                    cov[i, j] = value
        found[row] = 0.0
        for j in range(channels):
            value = 0.0
            for i in range(size):
                for k in range(size):
                    value += c[row, j, i] * cov[i, k] * c[row, j, k]
            found[row] = max(found[row], value)


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
