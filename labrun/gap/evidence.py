"""How well a model predicts data that its fit has not seen: log errors by unit of evidence.

A unit is a condition with all its repeats. Where conditions are few, each is cut into blocks of time longer than the
correlation time of the residual, so that the standard error over units rests on enough of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.fit import Dataset, Problem
from labrun.gap import criteria
from labrun.gap.held_out import ExcessResidual, excess, group_means, unseen_residuals
from labrun.gap.noise import Noise

_LEAST = 1e-12
"""Mean squared error, in units of the noise, below which a prediction is exact."""


@dataclass(frozen=True)
class Units:
    """How the data are divided into units of evidence.

    Attributes
    ----------
    blocks : per condition present
        Number of blocks of time that each condition is cut into.
    strata : (units,)
        Number of the condition of each unit.
    form_error : (units, m)
        Mean squared error that an idealised form is allowed in each unit, in units of the noise: it is part of every
        score, so that forms are not told apart by less.
    """

    blocks: tuple[int, ...]
    strata: IntArray
    form_error: FloatArray

    @classmethod
    def of(cls, data: Dataset, residual: Sequence[FloatArray]) -> "Units":
        """Divide data, given the residual (n, m) of every trial by the recalibrated model."""
        means = [mean for mean, _ in group_means(data, residual)]
        wanted = int(np.ceil(criteria.ENOUGH_UNITS / len(means))) if len(means) < criteria.ENOUGH_UNITS else 1
        blocks = tuple(min(wanted, max(1, int(len(mean) / correlation_samples(mean)))) for mean in means)
        if len(blocks) == 1:
            blocks = (max(blocks[0], min(2, len(means[0]))),)
        count, outputs = sum(blocks), means[0].shape[1]
        return cls(blocks, np.repeat(np.arange(len(blocks)), blocks), np.zeros((count, outputs)))

    def with_form_error_of(self, gap: FloatArray) -> "Units":
        """Return the units with the error that forms are allowed of a gap, squares (units, m) of the reference."""
        return replace(self, form_error=criteria.NEGLIGIBLE**2 * gap)


def correlation_samples(residual: FloatArray) -> float:
    """Return the number of samples after which a residual (n, m) has lost its correlation, the slowest channel's.

    It is the lag at which the autocorrelation first falls below zero; a whole trial where it never does.
    """
    longest = 1.0
    for column in residual.T:
        centred = column - np.mean(column)
        power = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
        correlation = np.fft.irfft(power)[: len(centred)]
        negative = np.flatnonzero(correlation < 0.0)
        if correlation[0] > 0.0:
            longest = max(longest, float(negative[0]) if negative.size else float(len(centred)))
    return longest


@dataclass(frozen=True)
class UnseenError:
    """What a model leaves of data that its fit has not seen.

    Attributes
    ----------
    log : (units,)
        Logarithm of the mean squared error of each unit, in units of one trial's noise, with the noise of one trial and
        the error that forms are allowed; of several outputs the mean of their logarithms, so that none outweighs the
        others.
    squares : (units, m)
        The mean squared errors, beyond the noise where it is known.
    excess
        The same residuals beyond the noise floor.
    rms : (m,)
        Root mean square of the residual of each output over all trials, in its unit.
    """

    log: FloatArray
    squares: FloatArray = field(repr=False)
    excess: ExcessResidual = field(repr=False)
    rms: FloatArray

    @property
    def mean(self) -> float:
        """Mean log error: the score of the model; lower is better."""
        return float(np.mean(self.log))

    @property
    def in_noise(self) -> float:
        """Root mean square of the systematic residual, in units of one trial's noise."""
        return self.excess.gap


def unseen_error(problem: Problem, z: FloatArray, noise: Noise, units: Units) -> UnseenError:
    """Predict every condition, or block of time, by a fit from `z` that has not seen it, and return the errors."""
    residual, beyond = zip(*unseen_residuals(problem, z), strict=True)
    return error_of(problem.data, noise, units, list(residual), list(beyond))


def error_of(
    data: Dataset, noise: Noise, units: Units, residual: Sequence[FloatArray], beyond: Sequence[float] = ()
) -> UnseenError:
    """Return the errors of residuals (n, m) of every trial.

    Parameters
    ----------
    beyond : per trial
        Squares that the trial's own deviations have beyond their spread: a deviation that all trials share is error.
    """
    rows: list[FloatArray] = []
    present = [group for group in range(len(data.conditions)) if data.of_group(group)]
    for group, blocks, (mean, count) in zip(present, units.blocks, group_means(data, residual), strict=True):
        own = float(np.mean([beyond[index] for index in data.of_group(group)])) if beyond else 0.0
        beyond_noise = own - noise.mean_floor(group, count) if noise.known else own
        parts = np.array_split(np.square(mean / noise.sd), blocks)
        rows += [np.maximum(np.mean(part, axis=0) + beyond_noise, _LEAST) for part in parts]
    squares = np.array(rows)
    noise_of_trial = 1.0 if noise.known else 0.0  # without repeats it is in the residual already
    log = np.mean(np.log(squares + noise_of_trial + units.form_error), axis=1)
    rms = np.sqrt(np.mean(np.square(np.concatenate(residual)), axis=0))
    return UnseenError(log, squares, excess(data, noise, residual, beyond), rms)
