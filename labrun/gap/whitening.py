"""Turning coloured noise into white noise: autoregressive prediction of each channel from its own past."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labrun.arrays import FloatArray
from labrun.gap import criteria


@dataclass(frozen=True)
class Predictor:
    """Best linear predictors of a stationary sequence of variance 1 from its 0, 1, ... p last values.

    Attributes
    ----------
    coefficients : p + 1 arrays of 0, 1, ... p numbers
        Of the value one back, two back ...
    deviation : (p + 1,)
        Standard deviation of what each leaves.
    """

    coefficients: tuple[FloatArray, ...]
    deviation: FloatArray

    @property
    def order(self) -> int:
        """How many last values it looks at."""
        return len(self.coefficients) - 1

    @cached_property
    def first(self) -> FloatArray:
        """What makes the first p values white, each from those before it, (p, p)."""
        matrix = np.eye(self.order)
        for k in range(self.order):
            matrix[k, :k] = -self.coefficients[k][::-1]
        return matrix / self.deviation[: self.order, None]


@dataclass(frozen=True)
class Whitener:
    """One predictor per channel."""

    predictors: tuple[Predictor, ...]

    def white(self, values: FloatArray) -> FloatArray:
        """Return (n, m) channels of standard deviation 1 as white noise of the same shape.

        The first samples, which have too short a past, are predicted from what there is (Levinson), so that nothing
        is lost or overweighted.
        """
        white = np.empty_like(values)
        for column, predictor in enumerate(self.predictors):
            p = predictor.order
            signal = values[:, column]
            if p == 0:
                white[:, column] = signal / predictor.deviation[0]
                continue
            numerator = np.concatenate([[1.0], -predictor.coefficients[p]])
            white[:, column] = np.convolve(signal, numerator)[: len(signal)] / predictor.deviation[p]
            first = min(p, len(signal))
            white[:first, column] = predictor.first[:first, :first] @ signal[:first]
        return white

    def coloured(self, white: FloatArray) -> FloatArray:
        """Return white noise (n, m) with the colour of the channels: what `white` undoes."""
        coloured = np.empty_like(white)
        from scipy.signal import lfilter, lfiltic

        for column, predictor in enumerate(self.predictors):
            p = predictor.order
            begin: list[float] = []
            for k in range(min(p, len(white))):
                past = np.array(begin[::-1])
                begin.append(
                    float(predictor.coefficients[k] @ past + predictor.deviation[k] * white[k, column])
                )
            coloured[: len(begin), column] = begin
            denominator = np.concatenate([[1.0], -predictor.coefficients[p]])
            if len(white) > p:
                driven = predictor.deviation[p] * white[p:, column]
                if p == 0:
                    coloured[:, column] = driven
                else:
                    state = lfiltic([1.0], denominator, np.array(begin[::-1]))
                    coloured[p:, column] = lfilter([1.0], denominator, driven, zi=state)[0]
        return coloured


def white(channels: int) -> Whitener:
    """Return the whitener of channels that are white already."""
    return Whitener(tuple(Predictor((np.empty(0),), np.ones(1)) for _ in range(channels)))


def fit_whitener(sequences: Sequence[FloatArray]) -> Whitener:
    """Fit predictors to sequences (n, m) that have standard deviation about 1, all of one colour per channel.

    Autocorrelations are pooled over the sequences; the order, at most 8, is the one with the least AICc.
    """
    channels = sequences[0].shape[1]
    return Whitener(tuple(_predictor([one[:, column] for one in sequences]) for column in range(channels)))


def _predictor(sequences: Sequence[FloatArray]) -> Predictor:
    longest = max(len(one) for one in sequences)
    total = sum(len(one) for one in sequences)
    most = max(0, min(criteria.MOST_ORDER, longest // 10))
    covariance = np.array(
        [
            sum(float(one[lag:] @ one[: len(one) - lag]) for one in sequences) / total
            for lag in range(most + 1)
        ]
    )
    if covariance[0] <= 0.0:
        return Predictor((np.empty(0),), np.ones(1))
    coefficients, variance = _levinson(covariance / covariance[0])
    orders = np.arange(len(variance))
    criterion = total * np.log(variance) + 2.0 * (orders + 1) * total / np.maximum(total - orders - 2, 1)
    best = int(np.argmin(criterion))
    return Predictor(tuple(coefficients[: best + 1]), np.sqrt(variance[: best + 1]))


def _levinson(correlation: FloatArray) -> tuple[list[FloatArray], FloatArray]:
    """Return the predictors of order 0, 1 ... and the variance each leaves (Levinson 1946, Durbin 1960)."""
    coefficients: list[FloatArray] = [np.empty(0)]
    variance = [1.0]
    for order in range(1, len(correlation)):
        last = coefficients[-1]
        reflection = (correlation[order] - last @ correlation[1:order][::-1]) / variance[-1]
        left = variance[-1] * (1.0 - reflection**2)
        if left <= criteria.LEAST_INNOVATION:
            break
        coefficients.append(np.concatenate([last - reflection * last[::-1], [reflection]]))
        variance.append(left)
    return coefficients, np.array(variance)
