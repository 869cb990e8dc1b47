"""The confirmed best: chosen by fresh repeats, reported from repeats that took no part in the choice.

The best of many noisy means is too good on average (the winner's curse), and so is the best of a few leaders after
they were measured again. Three stages keep the report unbiased: the search names leaders, fresh repeats
of the leaders name the winner, and as many again of the winner alone give its value and interval.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from labrun.arrays import FloatArray
from labrun.experiment import Condition, Leaders, RepeatRule, condition_key
from labrun.search.result import Best
from labrun.store import Role, TrialOutcome

Goal = Literal["maximise", "minimise"]
Numbers = Sequence[int | None]
"""The mounting of each value; None where nothing was set by hand."""


class Measured(Protocol):
    """What a measurement of one condition offers (`labrun.runner.Measurement`)."""

    @property
    def condition(self) -> Condition:
        """What was measured."""
        ...

    @property
    def outcomes(self) -> Sequence[object]:
        """Every trial, whatever its status."""
        ...

    def values(self, objective: str) -> FloatArray:
        """Return one value an accepted trial."""
        ...

    @property
    def mountings(self) -> Numbers:
        """The mounting of each accepted trial."""
        ...

    def truncation(self, objective: str) -> float:
        """Return what cut cycles may have done to the mean; 0 where none were cut."""
        ...


class Measures(Protocol):
    """What a search needs of a session (`labrun.runner.Session`)."""

    def measure(
        self,
        conditions: Sequence[Condition],
        *,
        role: Role = "measure",
        repeats: RepeatRule | None = None,
        order: Literal["shuffled", "as-listed"] = "shuffled",
    ) -> Sequence[Measured]:
        """Measure each condition; the answer is in the order of `conditions`."""
        ...


def honest_best(
    session: Measures,
    measured_all: Sequence[Measured],
    *,
    objective: str,
    goal: Goal,
    unit: str,
    leaders: Leaders,
    guests: Sequence[Condition] = (),
) -> Best | None:
    """Measure the leaders of a search again, and confirm the winner.

    Parameters
    ----------
    session
        Measures; fresh repeats have the role "fresh", confirming ones "confirm".
    measured_all
        All measurements of the search; several of one condition are pooled.
    leaders
        How many leaders, and how many fresh repeats each.
    guests
        Conditions that were found elsewhere, measured among the leaders.

    Returns
    -------
    Best or None
        None if no trial was accepted.
    """
    measured = ((m.condition, m.values(objective), m.truncation(objective)) for m in measured_all)
    top = leading_conditions(measured, goal, leaders.count)
    if not top:
        return None
    known = {condition_key(condition) for condition in top}
    top += [guest for guest in guests if condition_key(guest) not in known]
    rule = RepeatRule(min=leaders.repeats, max=leaders.repeats)
    fresh = session.measure(top, role="fresh", repeats=rule)
    means = [_signed_mean(m.values(objective), goal) - m.truncation(objective) for m in fresh]
    if all(mean == -math.inf for mean in means):
        return None
    winner = top[int(np.argmax(means))]
    confirmed = session.measure([winner], role="confirm", repeats=rule)
    values = np.concatenate([m.values(objective) for m in confirmed])
    if len(values) == 0:
        return None
    everything = np.concatenate([m.values(objective) for m in (*measured_all, *fresh, *confirmed)])
    truncation = confirmed[0].truncation(objective)
    luckiest = everything.max() if goal == "maximise" else everything.min()
    return Best(
        parameters=dict(winner),
        objective_name=objective,
        value=float(values.mean()),
        ci95=t_interval(values, [number for m in confirmed for number in m.mountings], truncation),
        unit=unit,
        luckiest=float(luckiest),
        trials=len(values),
        truncation=truncation,
    )


def leading_conditions(
    measured: Iterable[tuple[Condition, FloatArray, float]], goal: Goal, count: int | None = None
) -> list[Condition]:
    """Return the most promising distinct conditions, best first, by shrunken means; all of them without a `count`.

    Each measurement is a condition, its accepted values, and what cut cycles may have done to their mean.

    Each condition's mean is drawn towards the mean of all by the share of it that is noise (empirical Bayes):
    ``m + (mean - m) * t2 / (t2 + s2 / n)`` with s2 the pooled variance within conditions and t2 that between them.
    With equal numbers of repeats the order is that of the plain means; with unequal ones a condition that was
    measured once does not lead by luck alone. Efron & Morris (1975), doi:10.1080/01621459.1975.10479864.
    What cut cycles may have added to a mean does not make it lead either.
    """
    pooled: dict[tuple[tuple[str, object], ...], list[FloatArray]] = {}
    conditions: dict[tuple[tuple[str, object], ...], Condition] = {}
    cut: dict[tuple[tuple[str, object], ...], float] = {}
    for condition, values, truncation in measured:
        key = condition_key(condition)
        conditions.setdefault(key, condition)
        cut[key] = max(cut.get(key, 0.0), truncation)
        pooled.setdefault(key, []).append(values)
    samples = {key: values for key, blocks in pooled.items() if len(values := np.concatenate(blocks))}
    if not samples:
        return []
    keys = list(samples)
    shrunken = _shrunken_means(list(samples.values()))
    costs = (-shrunken if goal == "maximise" else shrunken) + np.array([cut[key] for key in keys])
    order = np.argsort(costs, kind="stable")
    return [conditions[keys[index]] for index in order[:count]]


def pooled_variance(samples: Sequence[FloatArray]) -> float | None:
    """Return the variance of single trials within conditions; None if no condition was repeated."""
    freedom = sum(len(values) - 1 for values in samples if len(values))
    if freedom <= 0:
        return None
    return sum(float(((values - values.mean()) ** 2).sum()) for values in samples if len(values)) / freedom


def _shrunken_means(samples: Sequence[FloatArray]) -> FloatArray:
    means = np.array([values.mean() for values in samples])
    noise = pooled_variance(samples)
    if noise is None or len(samples) < 3:
        return means
    error = noise / np.array([len(values) for values in samples])
    between = float(means.var(ddof=1) - error.mean())
    if between <= 0.0:
        return means
    centre = means.mean()
    return np.asarray(centre + (means - centre) * between / (between + error))


def _signed_mean(values: FloatArray, goal: Goal) -> float:
    if len(values) == 0:
        return -math.inf
    return float(values.mean()) if goal == "maximise" else -float(values.mean())


@dataclass(frozen=True, slots=True)
class BestYet:
    """The best mean so far, of so many trials."""

    condition: Condition
    objective: str
    value: float
    trials: int


class BestSoFar:
    """Follows the best mean among the conditions with the full number of repeats (any, before there is one).

    It is what a run has in hand, and optimistic: the honest best comes at its end. Reference trials do not count, nor
    do trials that were rejected or failed.
    """

    def __init__(self, objective: str, goal: Goal, repeats: int) -> None:
        self._objective, self._repeats = objective, repeats
        self._sign = 1.0 if goal == "maximise" else -1.0
        self._known: dict[object, BestYet] = {}
        self.best: BestYet | None = None

    def take(self, trial: TrialOutcome) -> bool:
        """Take in a trial; tell whether it makes another best."""
        value = trial.objectives.get(self._objective)
        if trial.status != "done" or trial.role == "reference" or value is None:
            return False
        key, before = condition_key(trial.condition), self.best
        known = self._known.get(key, BestYet(trial.condition, self._objective, 0.0, 0))
        mean = (known.value * known.trials + value) / (known.trials + 1)
        self._known[key] = replace(known, value=mean, trials=known.trials + 1)
        self.best = max(
            self._known.values(), key=lambda best: (best.trials >= self._repeats, self._sign * best.value)
        )
        return self.best != before


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
            values[np.array([mounting == number for mounting in mountings])]
            for number in dict.fromkeys(mountings)
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
    scatter_ = math.sqrt(max(0.0, excess / weight))
    return Scatter(
        None if variance is None else math.sqrt(variance), within_freedom, scatter_, between_freedom
    )
