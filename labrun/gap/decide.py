"""The one rule that decides what is a cause, in the order in which the documentation states it.

Evidence is a table of log errors: one row per model (a set of causes), one column per unit of evidence (a condition, or
a block of time where conditions are few). Each entry is the logarithm of the mean squared error of that unit, predicted
by a fit that has not seen it. Everything here is arithmetic on such tables: nothing is fitted or simulated.

1. `beats`: a model replaces a simpler one if its mean log error is lower by more than one standard error over the
   units and a margin of practical size.
2. `leader`: among accepted candidates that the best one does not beat, the simplest leads; the others are its rivals.
3. `win_frequencies`: how often each candidate wins when the units are resampled and steps 1 and 2 repeated.

The one-standard-error rule: Breiman, Friedman, Olshen, Stone, Classification and Regression Trees (1984), section
3.4.3; Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 2nd edition (2009), section 7.10.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.gap import criteria


@dataclass(frozen=True, slots=True)
class Comparison:
    """How much lower the log error of one model is than that of another, paired over units.

    Attributes
    ----------
    mean
        Mean difference; positive where the second model predicts better.
    standard_error
        Of that mean: over units, or over conditions where these scatter more than their blocks of time do. Infinite for
        a single unit, which tells nothing about its own scatter.
    """

    mean: float
    standard_error: float

    @property
    def is_better(self) -> bool:
        """Whether the second model predicts better by more than the standard error and the practical margin."""
        return self.mean - criteria.STANDARD_ERRORS * self.standard_error > criteria.MARGIN


def compare(before: FloatArray, after: FloatArray, strata: IntArray) -> Comparison:
    """Compare the log errors (units,) of two models; `strata` (units,) numbers the condition of each unit."""
    difference = before - after
    conditions = [float(np.mean(difference[strata == stratum])) for stratum in np.unique(strata)]
    errors = [_standard_error(difference), _standard_error(np.array(conditions))]
    finite = [error for error in errors if np.isfinite(error)]
    return Comparison(float(np.mean(difference)), max(finite, default=np.inf))


def _standard_error(values: FloatArray) -> float:
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else np.inf


def beats(after: FloatArray, before: FloatArray, strata: IntArray) -> bool:
    """Tell whether a model of log errors `after` replaces a simpler one of log errors `before` (rule 1)."""
    return compare(before, after, strata).is_better


def near_best(errors: FloatArray, strata: IntArray) -> IntArray:
    """Return the rows of a table (candidates, units) that the best one does not beat (rule 2), the best first."""
    order = np.argsort(np.mean(errors, axis=1), kind="stable")
    best = errors[order[0]]
    return np.array([row for row in order if row == order[0] or not beats(best, errors[row], strata)])


def leader(errors: FloatArray, complexity: Sequence[tuple[int, int]], strata: IntArray) -> int:
    """Return the row that leads: the simplest of those that the best one does not beat (rule 2).

    Parameters
    ----------
    errors : (candidates, units)
        Log errors.
    complexity
        Of each candidate: number of parameters, then how uncommon it is in practice.
    """
    near = near_best(errors, strata)
    return int(min(near, key=lambda row: (complexity[row], float(np.mean(errors[row])))))


def resamples(strata: IntArray, count: int, rng: np.random.Generator) -> IntArray:
    """Return `count` resamples (count, units) of the units, drawn with replacement within each stratum."""
    drawn = np.empty((count, len(strata)), dtype=np.intp)
    for stratum in np.unique(strata):
        members = np.flatnonzero(strata == stratum)
        drawn[:, members] = rng.choice(members, (count, len(members)))
    return drawn


def tempered(frequency: float, count: int) -> float:
    """Return a frequency among `count` resamples as a confidence: its log odds over one temperature.

    Resampling the units shows the scatter between conditions, not that a form of the library stands in for another one.
    """
    inside = min(max(frequency, 0.5 / count), 1.0 - 0.5 / count)
    odds = np.log(inside / (1.0 - inside)) / criteria.TEMPERATURE
    return float(1.0 / (1.0 + np.exp(-odds)))


def win_frequencies(
    base: FloatArray,
    errors: FloatArray,
    complexity: Sequence[tuple[int, int]],
    strata: IntArray,
    drawn: IntArray,
) -> FloatArray:
    """Return how often each candidate leads and beats the base among resampled units (rule 3), shape (candidates,).

    Parameters
    ----------
    base : (units,)
        Log errors of the model that the candidates are added to.
    errors : (candidates, units)
        Log errors with each of them.
    drawn : (resamples, units)
        As `resamples` returns them.
    """
    wins = np.zeros(len(errors))
    for units in drawn:
        accepted = [
            row for row, error in enumerate(errors) if beats(error[units], base[units], strata[units])
        ]
        if accepted:
            chosen = [complexity[row] for row in accepted]
            wins[accepted[leader(errors[np.ix_(accepted, units)], chosen, strata[units])]] += 1.0
    return wins / len(drawn)


def chosen_without_each_unit(
    errors: FloatArray, complexity: Sequence[tuple[int, int]], strata: IntArray
) -> IntArray:
    """Return the row that leads (rules 1 and 2) when a unit is left out of the choice, for each unit, (units,).

    Units are left out with their whole stratum, where there is more than one. The first row is the model without any
    cause; it stays where no other row beats it on the units that are kept, or none is kept.
    """
    several = len(np.unique(strata)) > 1
    chosen = np.zeros(len(strata), dtype=np.intp)
    for unit, stratum in enumerate(strata if len(strata) > 1 else ()):
        kept = strata != stratum if several else np.arange(len(strata)) != unit
        seen, groups = errors[:, kept], strata[kept]
        accepted = [row for row in range(1, len(errors)) if beats(seen[row], seen[0], groups)]
        if accepted:
            chosen[unit] = accepted[leader(seen[accepted], [complexity[row] for row in accepted], groups)]
    return chosen
