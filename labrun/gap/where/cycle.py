"""The cycle of periodic trials: its period, by what is stated and by a test, and the phase of every sample."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FREQUENCY_KEYS = ("frequency_hz", "freq_hz", "f_hz", "frequency", "freq", "f")
PERIOD_KEYS = ("period_s", "period")
_HARMONICS = 3
_FEWEST_CYCLES = 1.5
_FEWEST_SAMPLES = 16
_STATED_FIT = 0.7
"""Part of a signal's variance that a stated period must explain before it is believed to be this signal's."""
_FOUND_FIT = 0.8
"""Part of the second half's variance that a period found in the data must predict from the first half."""


@dataclass(frozen=True)
class Cycle:
    """A period, and when a cycle begins: the signal's fundamental passes its mean there, rising.

    Attributes
    ----------
    period_s, begin_s
    """

    period_s: float
    begin_s: float

    @property
    def frequency_hz(self) -> float:
        """One over the period."""
        return 1.0 / self.period_s

    def phase(self, time_s: FloatArray) -> FloatArray:
        """Return the part of the cycle that has passed at these times, 0 to 1."""
        return np.asarray(np.mod((time_s - self.begin_s) / self.period_s, 1.0), dtype=float)


def find_cycle(
    time_s: FloatArray, signals: Sequence[FloatArray], condition: Mapping[str, float | str]
) -> Cycle | None:
    """Return the cycle of one trial, or None where nothing in it repeats.

    A period stated in the condition is taken where one of the signals really has it. Else the first signal decides
    whose first half, continued as a Fourier series of three harmonics, predicts its second half.

    Parameters
    ----------
    time_s : (n,)
    signals : (n,) each
        In the order of trust: what drives the trial, then what moves.
    """
    if len(time_s) < _FEWEST_SAMPLES:
        return None
    duration = float(time_s[-1] - time_s[0])
    moving = [one for one in signals if np.ptp(one) > 0]
    for stated in _stated(condition):
        if _FEWEST_CYCLES * stated > duration or stated < 4.0 * duration / len(time_s):
            continue
        for signal in moving:
            if _explained(time_s, signal, stated) >= _STATED_FIT:
                return Cycle(stated, _begin(time_s, signal, stated))
    for signal in moving:
        period = _period(time_s, signal)
        if period is not None:
            return Cycle(period, _begin(time_s, signal, period))
    return None


def _stated(condition: Mapping[str, float | str]) -> list[float]:
    found = []
    for key, value in condition.items():
        if isinstance(value, str) or not value > 0:
            continue
        if key in FREQUENCY_KEYS:
            found.append(1.0 / float(value))
        elif key in PERIOD_KEYS:
            found.append(float(value))
    return found


def _design(time_s: FloatArray, period: float) -> FloatArray:
    angle = 2 * np.pi * time_s / period
    waves = [wave(k * angle) for k in range(1, _HARMONICS + 1) for wave in (np.sin, np.cos)]
    return np.stack([np.ones_like(time_s), *waves], axis=1)


def _series(time_s: FloatArray, signal: FloatArray, period: float) -> FloatArray:
    return np.asarray(np.linalg.lstsq(_design(time_s, period), signal, rcond=None)[0], dtype=float)


def _explained(time_s: FloatArray, signal: FloatArray, period: float) -> float:
    left = signal - _design(time_s, period) @ _series(time_s, signal, period)
    return 1.0 - float(np.var(left) / np.var(signal))


def _begin(time_s: FloatArray, signal: FloatArray, period: float) -> float:
    """Return when the fundamental a sin + b cos passes zero, rising."""
    sine, cosine = _series(time_s, signal, period)[1:3]
    return float(-np.arctan2(cosine, sine) * period / (2 * np.pi))


def _period(time_s: FloatArray, signal: FloatArray) -> float | None:
    from scipy.optimize import minimize_scalar

    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    values = np.interp(even, time_s, signal)
    padded = 4 * len(even)
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)), padded)) ** 2
    frequency = np.fft.rfftfreq(padded, even[1] - even[0])
    duration = float(even[-1] - even[0])
    possible = (frequency >= _FEWEST_CYCLES / duration) & (frequency <= 0.25 / (even[1] - even[0]))
    if not np.any(possible) or power.max() <= 0:
        return None
    top = float(frequency[possible][np.argmax(power[possible])])
    reach = 0.5 / duration
    best = minimize_scalar(
        lambda f: -_explained(even, values, 1.0 / f),
        bounds=(max(top - reach, 0.5 * top), top + reach),
        method="bounded",
    )
    period = float(1.0 / best.x)
    half = len(even) // 2
    predicted = _design(even[half:], period) @ _series(even[:half], values[:half], period)
    error = float(np.mean(np.square(values[half:] - predicted)))
    return period if error <= (1 - _FOUND_FIT) * float(np.var(values[half:])) else None
