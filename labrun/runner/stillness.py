"""How still a signal is, beyond what its noise explains."""

import math
from dataclasses import dataclass

import numpy as np

from labrun.devices import FloatArray

_BINS = 20
_LEAST_PER_BIN = 3
_CLIP = 5.0
_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, slots=True)
class Stillness:
    """Motion of several channels within one window, in their units.

    Attributes
    ----------
    spread : (channels,)
        Standard deviation of the slow part of the signal, beyond what noise explains.
    drift : (channels,)
        Change over the window by its slope, beyond twice its standard error.
    resolution : (channels,)
        The smallest spread or drift that stands out from the noise.
    """

    spread: FloatArray
    drift: FloatArray
    resolution: FloatArray


def stillness(time_s: FloatArray, values: FloatArray) -> Stillness | None:
    """Judge one window.

    Samples are averaged in up to 20 bins. The variance between bins, less what the noise within them explains, is that
    of the slow part (one-way random-effects analysis of variance; Searle, Casella, McCulloch, "Variance components",
    1992, sec. 3.6). Noise is taken from successive differences (von Neumann 1941), which a slow motion hardly enters.
    Two standard errors of the estimate are taken off as well, so that white sensor noise alone, however strong, does
    not count as motion, while a wall echo of 0.1 to 1 Hz well below the noise of a single sample does. Single wild
    samples are clipped at five robust standard deviations from their bin's median. Drift is the slope of the bins'
    means times the window, less two of its standard errors.

    Parameters
    ----------
    time_s : (n,)
        Times of the samples, ascending.
    values : (n, channels)
        The signals.

    Returns
    -------
    Stillness or None
        None with too few samples to tell noise from motion (fewer than 12).
    """
    count = len(values)
    bins = min(_BINS, count // _LEAST_PER_BIN)
    if bins < 4:
        return None
    each = count // bins
    start = count - bins * each
    # One row a bin, so that every operation runs along memory.
    grouped = np.ascontiguousarray(values[start:].T).reshape(-1, bins, each)
    centre = _median(grouped)
    rest = grouped - centre
    scale = _SIGMA * _median(np.abs(rest).reshape(-1, 1, bins * each))
    ceiling = _CLIP * scale
    ceiling[ceiling <= 0.0] = np.inf
    rest = np.minimum(np.maximum(rest, -ceiling), ceiling)
    means = centre[:, :, 0] + np.add.reduce(rest, axis=2) / each
    steps = rest[:, :, 1:] - rest[:, :, :-1]
    within = np.add.reduce(steps * steps, axis=(1, 2)) / (bins * (each - 1) * 2.0 * each)
    apart = means - (np.add.reduce(means, axis=1) / bins)[:, None]
    between = np.add.reduce(apart * apart, axis=1) / (bins - 1)
    uncertainty = within * math.sqrt(2.0 / (bins - 1))
    spread = np.sqrt(np.maximum(0.0, between - within - 2.0 * uncertainty))
    times = np.add.reduce(time_s[start:].reshape(bins, each), axis=1) / each
    centred = times - np.add.reduce(times) / bins
    length_s = float(time_s[-1] - time_s[0])
    moment = float(centred @ centred)
    slope = apart @ centred / moment
    error = np.sqrt(within / moment)
    drift = np.maximum(0.0, np.abs(slope) - 2.0 * error) * length_s
    return Stillness(spread, drift, np.maximum(np.sqrt(uncertainty), error * length_s))


def _median(values: FloatArray) -> FloatArray:
    """Return the median over the last axis, kept; `numpy.median` checks more, and is slow on small arrays."""
    middle = values.shape[2] // 2
    if values.shape[2] % 2:
        return np.partition(values, middle, axis=2)[:, :, middle : middle + 1]
    lower = np.partition(values, (middle - 1, middle), axis=2)
    return np.asarray(0.5 * (lower[:, :, middle - 1 : middle] + lower[:, :, middle : middle + 1]))
