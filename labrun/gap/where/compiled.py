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
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
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

    Returns
    -------
    gains : (n, m, k), variances : (n, m), innovations : (n, m, b)
        For `left_over`.
    likelihood : (b,)
        Logarithm, without its constant.
    """
    count, channels, size = c.shape
    many = series.shape[2]
    gains, variances, innovations = np.empty(c.shape), np.empty(r.shape), np.empty(series.shape)
    likelihood = np.zeros(many)
    cov, product = np.zeros((size, size)), np.zeros((size, size))
    state, moved = np.zeros((size, many)), np.zeros((size, many))
    z = np.empty(size)
    moves, moved_by = np.empty(size, dtype=np.int64), np.empty((size, size), dtype=np.int64)
    shows, shown_by = np.empty(channels, dtype=np.int64), np.empty((channels, size), dtype=np.int64)
    _entries(phi, moves, moved_by)
    _entries(c, shows, shown_by)
    for row in range(count):
        if begin[row] != 0:
            state[:] = 0.0
            cov[:] = intensity * start + still
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
    return gains, variances, innovations, likelihood


@kernel
def left_over(
    phi: FloatArray,
    begin: IntArray,
    c: FloatArray,
    r: FloatArray,
    gains: FloatArray,
    variances: FloatArray,
    innovations: FloatArray,
) -> FloatArray:
    """Return what the smoothed disturbance leaves of each series, (b,), in units of the noise.

    Backward recursion of the disturbance smoother (de Jong 1989; Koopman 1993), channel after channel.
    """
    count, channels, size = c.shape
    squares, back = np.zeros(innovations.shape[2]), np.zeros((size, innovations.shape[2]))
    for row in range(count - 1, -1, -1):
        for j in range(channels - 1, -1, -1):
            value = innovations[row, j] / variances[row, j] - gains[row, j] @ back
            squares += r[row, j] * value**2
            for i in range(size):
                back[i] += c[row, j, i] * value
        if begin[row] != 0:
            back[:] = 0.0
        else:
            back = phi[row - 1].T @ back
    return squares


@kernel
def spread_of(
    phi: FloatArray, q: FloatArray, begin: IntArray, c: FloatArray, start: FloatArray
) -> FloatArray:
    """Return the largest variance of an output that a disturbance of intensity 1 makes, (n,)."""
    found, cov = np.zeros(len(c)), np.zeros(start.shape)
    for row in range(len(c)):
        if begin[row] != 0:
            cov[:] = start
        else:
            cov = phi[row - 1] @ cov @ phi[row - 1].T + q[row - 1]
        for j in range(c.shape[1]):
            found[row] = max(found[row], c[row, j] @ cov @ c[row, j])
    return found


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
    channels: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of slopes (n, k, k) and outputs (n, m, k) by the states, by central differences.

    Parameters
    ----------
    time_s : (n,), states : (n, k), u : (n, inputs)
    steps : (k,)
        Of the differences.
    forces : (2, k, n, sites)
        At the sites, for each state a step ahead and a step behind.
    """
    count, size = states.shape
    a, c = np.zeros((count, size, size)), np.zeros((count, channels, size))
    force, row_u = np.zeros(forces.shape[3] + 1), np.zeros(u.shape[1] + 1)
    state, slope, y = np.empty(size), np.empty(size), np.empty(channels)
    for row in range(count):
        row_u[:-1] = u[row]
        state[:] = states[row]
        for k in range(size):
            for side in range(2):
                factor = (1.0 - 2.0 * side) / (2.0 * steps[k])
                state[k] = states[row, k] + (1.0 - 2.0 * side) * steps[k]
                force[:-1] = forces[side, k, row]
                call_model(derivative, time_s[row], state, row_u, p, force, slope)
                call_model(output, time_s[row], state, row_u, p, force, y)
                a[row, :, k] += factor * slope
                c[row, :, k] += factor * y
            state[k] = states[row, k]
    return a, c
