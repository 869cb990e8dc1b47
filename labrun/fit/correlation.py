"""How long a residual stays correlated."""

from collections.abc import Sequence

import numpy as np

from labrun.arrays import FloatArray


def correlation_length(parts: Sequence[FloatArray]) -> float:
    """Return the integrated autocorrelation of pieces of one signal, in samples: 1 + 2 sum of correlations.

    The sum ends where the correlation first turns negative (Geyer 1992, the initial positive sequence).
    """
    longest = max(len(part) for part in parts)
    total = np.zeros(longest)
    for part in parts:
        # about zero, not about its own mean: a constant residual is the most correlated one
        spectrum = np.fft.rfft(part, 2 * len(part))
        total[: len(part)] += np.fft.irfft(spectrum.real**2 + spectrum.imag**2, 2 * len(part))[: len(part)]
    if total[0] <= 0.0:
        return 1.0
    correlation = total / total[0]
    negative = np.flatnonzero(correlation < 0.0)
    end = int(negative[0]) if len(negative) else longest
    return float(np.clip(1.0 + 2.0 * np.sum(correlation[1:end]), 1.0, longest))
