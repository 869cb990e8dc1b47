"""Fourier series of one swing, differentiated analytically, as in chapter 3 of the source work."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.errors import FitError

FloatArray = NDArray[np.float64]

_EXTENSION = 1.25
"""Fundamental period over record length."""
_LOWEST, _HIGHEST = 1.5, 4.0
"""Range of the highest harmonic, in units of the swing's own frequency."""
_SMALLEST_SINGULAR = 1e-9
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
    which a truncated singular value decomposition takes care of. The order is the one with the smallest Bayesian
    information criterion between 1.5 and 4 times the swing's own frequency: higher harmonics would only follow noise,
    which two differentiations multiply.
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
    order = _best_order(centred, angle, period_s, lowest, max(highest, lowest))
    omega = 2.0 * np.pi * np.arange(1, order + 1) / period_s
    coefficients = np.linalg.lstsq(_basis(centred, period_s, order), angle, rcond=_SMALLEST_SINGULAR)[0]
    noise = float(np.sqrt(np.mean((angle - _basis(centred, period_s, order) @ coefficients) ** 2)))
    trim_s = max(_TRIM * duration_s, 0.5 / frequency_hz)
    inside = np.abs(centred) <= 0.5 * duration_s - trim_s
    basis = _basis(centred[inside], period_s, order)
    constant, cosines, sines = coefficients[0], coefficients[1::2], coefficients[2::2]

    def value(first: NDArray[Any], second: NDArray[Any]) -> FloatArray:
        return np.asarray(basis[:, 1::2] @ first + basis[:, 2::2] @ second)

    return FourierSwing(
        time_s[inside],
        constant + value(cosines, sines),
        value(omega * sines, -omega * cosines),
        -value(omega**2 * cosines, omega**2 * sines),
        order,
        noise,
    )


def _basis(time_s: FloatArray, period_s: float, order: int) -> FloatArray:
    """Return 1, cos, sin, cos 2, sin 2, ... as columns."""
    phase = 2.0 * np.pi / period_s * np.outer(time_s, np.arange(1, order + 1))
    basis = np.ones((len(time_s), 2 * order + 1))
    basis[:, 1::2], basis[:, 2::2] = np.cos(phase), np.sin(phase)
    return basis


def _best_order(time_s: FloatArray, angle: FloatArray, period_s: float, lowest: int, highest: int) -> int:
    """Return the order of smallest BIC; one QR of the largest basis gives the residual of all smaller ones."""
    basis, _ = np.linalg.qr(_basis(time_s, period_s, highest))
    explained = np.cumsum((basis.T @ angle) ** 2)
    orders = np.arange(lowest, highest + 1)
    number = len(angle)
    floor = 1e-20 * float(angle @ angle)
    left = np.maximum(float(angle @ angle) - explained[2 * orders], floor)
    criterion = number * np.log(left / number) + np.log(number) * (2 * orders + 1)
    return int(orders[np.argmin(criterion)])


def _dominant_frequency(time_s: FloatArray, angle: FloatArray) -> float:
    """Return the frequency of the largest peak of the spectrum, Hz."""
    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    values = np.interp(even, time_s, angle)
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)), 4 * len(values)))
    frequencies = np.fft.rfftfreq(4 * len(values), even[1] - even[0])
    # below one swing per record lies drift, not a swing
    spectrum[frequencies < 1.0 / (even[-1] - even[0])] = 0.0
    return float(frequencies[np.argmax(spectrum)])
