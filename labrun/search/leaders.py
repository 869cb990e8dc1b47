"""The honest best: chosen by fresh repeats, reported from repeats that took no part in the choice.

The best of many noisy means is too good on average (the winner's curse), and so is the best of a few leaders after
they were measured again. Three stages keep the report unbiased: the search names leaders, fresh repeats
of the leaders name the winner, and as many again of the winner alone give its value and interval.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Literal, Protocol

import numpy as np

from labrun.arrays import FloatArray
from labrun.search.mountings import Numbers, t_interval
from labrun.search.result import Best
from labrun.spec import Condition, Leaders, RepeatRule, condition_key
from labrun.store import Role

Goal = Literal["maximise", "minimise"]


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
    found: Sequence[Measured],
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
    found
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
    measured = ((m.condition, m.values(objective), m.truncation(objective)) for m in found)
    top = leading_conditions(measured, goal, leaders.count)
    if not top:
        return None
    known = {condition_key(one) for one in top}
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
    everything = np.concatenate([m.values(objective) for m in (*found, *fresh, *confirmed)])
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
    found: Iterable[tuple[Condition, FloatArray, float]], goal: Goal, count: int | None = None
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
    for condition, values, truncation in found:
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
