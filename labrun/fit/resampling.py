"""Intervals from resampling whole trials without refitting, by one Gauss-Newton step; how long residuals correlate."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray

LEVEL = 0.95
FEW_MOUNTINGS = 5
"""So many should be behind an interval; it is coarse with fewer."""
_LEAST_FREEDOM = 1e-3
"""Smallest share of a direction that other trials must determine, for the leverage correction."""


@dataclass(frozen=True, slots=True)
class Resampled:
    """Deviations of resampled estimates from the estimate.

    Attributes
    ----------
    draws : (b, p)
        One row a resample, already expanded for the number of trials.
    low, high : (p,)
        Ends of the 95 % interval, relative to the estimate.
    """

    draws: FloatArray
    low: FloatArray
    high: FloatArray


def resample_trials(
    information: FloatArray,
    score: FloatArray,
    *,
    rng: np.random.Generator,
    prior_sigma: FloatArray | None = None,
    resamples: int = 2000,
) -> Resampled:
    """Resample whole trials and re-estimate by one Gauss-Newton step from the optimum.

    Each trial enters with its own sums J'J and J'r only, so that a resample costs one small linear solve: with
    multiplicities m_i, the step is ``(prior + sum m_i J_i'J_i)^-1 sum m_i J_i'r_i``. Residuals may be correlated in
    time and differ from trial to trial in any way; only the trials must be independent of one another.

    Few trials make a plain bootstrap too narrow, for two reasons, each corrected:

    - a trial pulls the estimate towards itself, so that its residual is too small. Each trial's score is divided by
      the square root of what the other trials determine, ``(I - H_i)^(-1/2)``, with H_i the trial's share of the
      whole information: the CR2 correction of Bell and McCaffrey (2002), here in parameter space, which for
      equal trials is the factor sqrt(T/(T-1));
    - the spread itself is estimated from T trials: deviations are expanded by Student's t with T-1 degrees
      of freedom over the normal quantile (4.3/1.96 for three trials).

    On linear models with 3 to 20 unequal trials this covered the truth in 93 to 95 % of simulated data sets.

    Parameters
    ----------
    information : (T, p, p)
        J_i'J_i of every trial, nuisance parameters (its own initial states) already eliminated.
    score : (T, p)
        J_i'r_i of every trial at the optimum, r measured minus simulated.
    prior_sigma : (p,), optional
        Standard deviation of what was known beforehand, inf where nothing was. Prior knowledge is resampled as the
        measurement it stands for, so that a parameter known by its prior alone keeps the prior's width.
    """
    from scipy.special import ndtri

    trials, size = score.shape
    precision = np.zeros(size) if prior_sigma is None else 1.0 / np.square(prior_sigma)
    # one scale for all parameters: their units must not decide which eigenvalue counts as zero
    total = information.sum(axis=0) + np.diag(precision)
    scale = 1.0 / np.sqrt(np.where(np.diag(total) > 0, np.diag(total), 1.0))
    information = information * scale[:, None] * scale
    score = score * scale
    precision = precision * scale**2
    total = total * scale[:, None] * scale
    adjusted = _leverage_corrected(information, score, total)
    # what is left of the sum at the optimum is the prior's pull, which stays as it is
    adjusted = adjusted - adjusted.mean(axis=0)
    counts = rng.multinomial(trials, np.full(trials, 1.0 / trials), size=resamples)
    matrices = np.tensordot(counts, information, (1, 0)) + np.diag(precision) + 1e-9 * np.eye(size)
    pulls = counts @ adjusted + np.sqrt(precision) * rng.standard_normal((resamples, size))
    draws = np.linalg.solve(matrices, pulls[..., None])[..., 0] * scale
    draws *= student(trials - 1) / float(ndtri(0.5 * (1.0 + LEVEL)))
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.percentile(draws, [tail, 100.0 - tail], axis=0)
    # the estimate itself is always inside: a step of a skewed resample must not push the interval past it
    return Resampled(draws, np.minimum(low, 0.0), np.maximum(high, 0.0))


def by_mounting(
    information: FloatArray, score: FloatArray, mountings: Sequence[int | None]
) -> tuple[FloatArray, FloatArray, str]:
    """Sum J'J and J'r of the trials of each mounting: these, not their trials, are independent of one another.

    Returns
    -------
    information : (M, p, p)
    score : (M, p)
    remark
        What has to be said of it: how few mountings there are; empty where nothing has.
    """
    numbers = list(dict.fromkeys(mountings))
    if numbers == [None] or len(numbers) == len(mountings):
        return information, score, ""
    if len(numbers) == 1:
        return (
            information,
            score,
            "all trials are of one mounting: how mountings differ is not in the intervals",
        )
    owner = np.array([numbers.index(number) for number in mountings])
    sums = np.zeros((len(numbers), *information.shape[1:])), np.zeros((len(numbers), score.shape[1]))
    np.add.at(sums[0], owner, information)
    np.add.at(sums[1], owner, score)
    few = f"intervals rest on {len(numbers)} mountings of {len(mountings)} trials"
    return *sums, few if len(numbers) < FEW_MOUNTINGS else ""


def _leverage_corrected(information: FloatArray, score: FloatArray, total: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(total)
    root = np.sqrt(np.maximum(values, 1e-12 * max(float(values[-1]), 1e-300)))
    half, inverse_half = (vectors * root) @ vectors.T, (vectors / root) @ vectors.T
    corrected = np.empty_like(score)
    for index, (matrix, pull) in enumerate(zip(information, score, strict=True)):
        share, basis = np.linalg.eigh(inverse_half @ matrix @ inverse_half)
        factor = 1.0 / np.sqrt(np.clip(1.0 - share, _LEAST_FREEDOM, 1.0))
        corrected[index] = half @ ((basis * factor) @ (basis.T @ (inverse_half @ pull)))
    return corrected


def student(freedom: int, quantile: float = 0.5 * (1.0 + LEVEL)) -> float:
    """Return a quantile of Student's t."""
    from scipy.special import stdtrit  # scipy.stats takes half a second to import

    return float(stdtrit(freedom, quantile))


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
