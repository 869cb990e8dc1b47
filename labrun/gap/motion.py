"""The motion that a log shows: coordinates without noise, rates and accelerations."""

import numpy as np

from labrun.arrays import FloatArray

_FEWEST = 8
"""Samples that a smoothing spline needs."""
_AT_ENDS = 12
"""Samples from which slopes at both ends are taken."""


def smoothed(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return coordinates (n, m), rates and accelerations of one trial by cubic smoothing splines.

    How much is smoothed is chosen for each column by generalized cross-validation (Craven and Wahba, Numerische
    Mathematik 31 (1979) 377): white noise goes, what the motion repeats from sample to sample stays.
    """
    from scipy.interpolate import CubicSpline, make_smoothing_spline

    motions = []
    for column in values.T:
        moves = np.ptp(column) > 0 and len(column) >= _FEWEST
        spline = (
            make_smoothing_spline(time_s, column, lam=_strength(time_s, column))
            if moves
            else CubicSpline(time_s, column)
        )
        motions.append([spline(time_s), spline.derivative(1)(time_s), spline.derivative(2)(time_s)])
    rows = np.array(motions)
    return rows[:, 0].T.copy(), rows[:, 1].T.copy(), rows[:, 2].T.copy()


def _strength(time_s: FloatArray, values: FloatArray) -> float:
    """Return the weight of the squared second derivative with the least cross-validated error.

    A spline of that weight passes a cosine of angular frequency w by 1 / (1 + weight step w^4) (Silverman, Annals of
    Statistics 12 (1984) 898): in cosines, residual and degrees of freedom of every weight are sums.
    """
    from scipy.fft import dct
    from scipy.interpolate import CubicHermiteSpline

    count = len(values)
    step = float(time_s[-1] - time_s[0]) / (count - 1)
    # cosines are level at both ends: what is not would need many of them, and pass for motion
    few = min(_AT_ENDS, count)
    begin, end = (
        np.polynomial.Polynomial.fit(time_s[part], values[part], 2)
        for part in (slice(None, few), slice(-few, None))
    )
    ends, at = (begin, end), time_s[[0, -1]]
    through = CubicHermiteSpline(
        at,
        [end(t) for end, t in zip(ends, at, strict=True)],
        [end.deriv()(t) for end, t in zip(ends, at, strict=True)],
    )
    power = np.square(dct(values - through(time_s), norm="ortho"))
    omega = np.pi * np.arange(count) / (count * step)
    weights = np.geomspace(1e-4, 1e12, 129) * step**3 / np.pi**4
    kept = 1.0 / (1.0 + weights[:, None] * step * omega**4)
    score = ((1.0 - kept) ** 2 @ power) / np.square(1.0 - kept.mean(axis=1))
    return float(weights[int(np.argmin(score))])
