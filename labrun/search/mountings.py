"""How far repeated values scatter within a mounting and between mountings, and what a mean is then worth."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray

Numbers = Sequence[int | None]
"""The mounting of each value; None where nothing was set by hand."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviations of one objective, pooled over conditions.

    Attributes
    ----------
    within, within_freedom
        Of single values in one mounting, with the degrees of freedom behind it; None without a repeat in a mounting.
    between, between_freedom
        Of what a mounting adds of its own, with those of the mountings; None where no condition was mounted twice. Zero
        where mountings differ no more than the scatter within them accounts for.
    """

    within: float | None
    within_freedom: int
    between: float | None
    between_freedom: int


def mean_error(values: FloatArray, mountings: Numbers = ()) -> tuple[float, int] | None:
    """Return the standard error of the mean of repeated values, and its degrees of freedom; None for fewer than two.

    Values of one mounting share what is peculiar to it. Where there are several mountings, these are what is
    independent: the error follows from how their sums deviate, as for clusters (Liang and Zeger 1986, with the factor
    M / (M - 1) for M clusters; for equal numbers of repeats, the standard error of the mountings' means).
    """
    count, numbers = len(values), list(dict.fromkeys(mountings))
    if count < 2:
        return None
    if len(numbers) < 2:
        return float(values.std(ddof=1)) / math.sqrt(count), count - 1
    owner = np.array([numbers.index(number) for number in mountings])
    sums = np.bincount(owner, weights=values - values.mean())
    several = len(numbers)
    return math.sqrt(several / (several - 1) * float(sums @ sums)) / count, several - 1


def t_interval(
    values: FloatArray, mountings: Numbers = (), truncation: float = 0.0
) -> tuple[float, float] | None:
    """Return the 95 % Student interval of the mean of repeated values, see `mean_error`; None for fewer than two.

    `truncation` bounds what cut cycles do to every repeat alike: no number of repeats averages it out, so that it is
    added to either side.
    """
    error = mean_error(values, mountings)
    if error is None:
        return None
    from scipy.special import stdtrit  # a tenth of a second

    half, mean = float(stdtrit(error[1], 0.975)) * error[0] + truncation, float(values.mean())
    return mean - half, mean + half


def scatter(samples: Iterable[tuple[FloatArray, Numbers]]) -> Scatter:
    """Return the scatter within and between mountings of conditions that were measured repeatedly.

    One-way analysis of variance, each condition about its own mean, by moments for unequal numbers (Searle, Casella and
    McCulloch 1992, section 3.6): the mean squares of mountings exceed those within by n0 times the variance between.

    Parameters
    ----------
    samples
        Of each condition its values, and the mounting of each.
    """
    within = between = weight = 0.0
    within_freedom = between_freedom = 0
    for values, mountings in samples:
        groups = [
            values[np.array([one == number for one in mountings])] for number in dict.fromkeys(mountings)
        ]
        sizes = np.array([len(group) for group in groups])
        if not len(values):
            continue
        within += sum(float(((group - group.mean()) ** 2).sum()) for group in groups)
        within_freedom += len(values) - len(groups)
        between += float(sizes @ np.array([(group.mean() - values.mean()) ** 2 for group in groups]))
        between_freedom += len(groups) - 1
        weight += len(values) - float(sizes @ sizes) / len(values)
    variance = within / within_freedom if within_freedom else None
    if not between_freedom:
        return Scatter(None if variance is None else math.sqrt(variance), within_freedom, None, 0)
    excess = between - between_freedom * (variance or 0.0)
    found = math.sqrt(max(0.0, excess / weight))
    return Scatter(None if variance is None else math.sqrt(variance), within_freedom, found, between_freedom)
