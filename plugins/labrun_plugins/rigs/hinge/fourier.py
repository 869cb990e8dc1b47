"""Fourier series of one swing, differentiated analytically, as in chapter 3 of the source work."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from labrun.devices import FloatArray
from labrun.errors import FitError

ComplexArray = NDArray[np.complex128]

_EXTENSION = 1.25
"""Fundamental period over record length."""
_LOWEST, _HIGHEST = 1.5, 4.0
"""Range of the highest harmonic, in units of the swing's own frequency."""
_RIDGE = 1e-13
"""Squared singular values below this share of the number of samples count as nothing."""
_TRIM = 0.05


@dataclass(frozen=True, slots=True)
class FourierSwing:
    """A swing and its derivatives, away from the ends of the record.

    Attributes
    ----------
    time_s, angle, rate, acceleration : (n,)
        rad, rad/s, rad/s^2.
    order
        Number of harmonics.
    noise
        Root mean square of what the series leaves, rad: the sensor's noise, if the series follows the swing.
    """

    time_s: FloatArray
    angle: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    order: int
    noise: float


def fit_fourier(time_s: FloatArray, angle: FloatArray, label: str = "the record") -> FourierSwing:
    """Fit a Fourier series to one decaying swing by least squares and differentiate it.

    A decaying record is not periodic, and a series over its own length would ring at both ends. The series is
    therefore given a fundamental period 1.25 times the record's length (a Fourier extension: Boyd 2002,
    Huybrechs 2010), in whose free quarter it may close as it likes; the least-squares problem is then ill-conditioned,
    which a slight ridge takes care of. The order is the one with the smallest Bayesian information criterion between
    1.5 and 4 times the swing's own frequency: higher harmonics would only follow noise, which two differentiations
    multiply.
    Derivatives are least certain at the ends: 5 % of the record, or half a swing if that is longer, is dropped at each.

    Parameters
    ----------
    time_s : (n,)
        Need not be evenly spaced.
    angle : (n,)
        rad.

    Raises
    ------
    FitError
        Too short a record: less than three swings, or less than eight samples a swing.
    """
    duration_s = float(time_s[-1] - time_s[0])
    frequency_hz = _dominant_frequency(time_s, angle)
    per_swing = len(time_s) / (duration_s * frequency_hz)
    if duration_s * frequency_hz < 3.0 or per_swing < 8.0:
        raise FitError(
            f"{label} holds {duration_s * frequency_hz:.1f} swings of {per_swing:.0f} samples: "
            "too little for a Fourier series",
            hint="record at least three swings, at eight samples a swing or more",
        )
    period_s = _EXTENSION * duration_s
    lowest = max(int(_LOWEST * frequency_hz * period_s), 2)
    highest = int(min(_HIGHEST * frequency_hz * period_s, len(time_s) / 4))
    centred = time_s - 0.5 * (time_s[0] + time_s[-1])
    waves = _waves(centred, period_s, max(highest, lowest))
    order, coefficients = _series(waves, angle, lowest)
    noise = float(np.sqrt(np.mean((angle - (waves[:, : order + 1] @ coefficients).real) ** 2)))
    trim_s = max(_TRIM * duration_s, 0.5 / frequency_hz)
    inside = np.abs(centred) <= 0.5 * duration_s - trim_s
    turn = 2j * np.pi / period_s * np.arange(order + 1)
    values = waves[inside, : order + 1] @ np.column_stack(
        [coefficients, turn * coefficients, turn**2 * coefficients]
    )
    return FourierSwing(time_s[inside], values[:, 0].real, values[:, 1].real, values[:, 2].real, order, noise)


def _waves(time_s: FloatArray, period_s: float, highest: int) -> ComplexArray:
    """Return exp(i m w t) for m = 0 ... highest as columns, by repeated multiplication."""
    waves = np.ones((len(time_s), highest + 1), dtype=complex)
    waves[:, 1] = np.exp(2j * np.pi / period_s * time_s)
    known = 1
    while known < highest:
        new = min(known, highest - known)
        waves[:, known + 1 : known + 1 + new] = waves[:, 1 : new + 1] * waves[:, known : known + 1]
        known += new
    return waves


def _series(waves: ComplexArray, angle: FloatArray, lowest: int) -> tuple[int, ComplexArray]:
    """Return the order of smallest BIC and its complex coefficients (angle = Re sum c_m exp(i m w t)).

    Products of two waves are waves, so that the normal equations need the sums of single waves only; one Cholesky
    factor of the largest holds the factors, and so the residuals, of all smaller ones.
    """
    number, highest = len(angle), waves.shape[1] - 1
    sums = np.concatenate([waves.sum(axis=0), waves[:, 1:].T @ waves[:, -1]])
    gram = _gram(sums, highest)
    gram[np.diag_indices_from(gram)] += _RIDGE * number
    pulls = angle @ waves
    right = np.empty(2 * highest + 1)
    right[0], right[1::2], right[2::2] = pulls[0].real, pulls[1:].real, -pulls[1:].imag
    factor = cholesky(gram, lower=True)
    forward = solve_triangular(factor, right, lower=True)
    orders = np.arange(lowest, highest + 1)
    total = float(angle @ angle)
    left = np.maximum(total - np.cumsum(forward**2)[2 * orders], 1e-20 * total)
    criterion = number * np.log(left / number) + np.log(number) * (2 * orders + 1)
    order = int(orders[np.argmin(criterion)])
    size = 2 * order + 1
    solved = solve_triangular(factor[:size, :size], forward[:size], lower=True, trans="T")
    return order, np.concatenate([solved[:1], solved[1::2] + 1j * solved[2::2]])


def _gram(sums: ComplexArray, highest: int) -> FloatArray:
    """Return B'B of the basis 1, cos, -sin, cos 2, -sin 2, ... from the sums of exp(i m w t)."""
    index = np.arange(highest + 1)
    apart = index[:, None] - index
    difference = np.where(apart >= 0, sums[np.abs(apart)], np.conj(sums[np.abs(apart)]))
    together = sums[index[:, None] + index]
    gram = np.empty((2 * highest + 2, 2 * highest + 2))
    gram[0::2, 0::2] = 0.5 * (together + difference).real
    gram[1::2, 1::2] = 0.5 * (difference - together).real
    gram[1::2, 0::2] = -0.5 * (together + difference).imag
    gram[0::2, 1::2] = gram[1::2, 0::2].T
    # the sine of order zero is no part of the basis
    return np.delete(np.delete(gram, 1, axis=0), 1, axis=1)


def _dominant_frequency(time_s: FloatArray, angle: FloatArray) -> float:
    """Return the frequency of the largest peak of the spectrum, Hz."""
    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    values = np.interp(even, time_s, angle)
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)), 4 * len(values)))
    frequencies = np.fft.rfftfreq(4 * len(values), even[1] - even[0])
    # below one swing per record lies drift, not a swing
    spectrum[frequencies < 1.0 / (even[-1] - even[0])] = 0.0
    return float(frequencies[np.argmax(spectrum)])
