"""A candidate measured at several settings: one value from all of them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.devices import Excess
from labrun.search.constraints import LimitExcesses
from labrun.search.leaders import Measured, Measures
from labrun.search.mountings import Numbers
from labrun.spec import Combine, Condition, Experiment, RepeatRule
from labrun.store import Role


def settings_of(experiment: Experiment) -> list[Condition]:
    """Return the settings that each candidate is measured at, all combinations of `over`; one without any if none."""
    over = experiment.over
    return [dict(zip(over, values, strict=True)) for values in itertools.product(*over.values())]


def levels_of(experiment: Experiment) -> list[Condition]:
    """Return the levels that get a search of their own, all combinations of `each`; one without any if none."""
    each = experiment.each
    return [dict(zip(each, values, strict=True)) for values in itertools.product(*each.values())]


def at_settings(conditions: Sequence[Condition], settings: Sequence[Condition]) -> list[Condition]:
    """Return each condition at each of the settings, those of one condition next to each other."""
    return [{**condition, **setting} for condition in conditions for setting in settings]


def excess_at_settings(excess_of: LimitExcesses, settings: Sequence[Condition]) -> LimitExcesses:
    """Return a function that tells what a candidate would break at any of the settings, each limit once."""

    def excess(condition: Condition) -> list[Excess]:
        found: dict[str, Excess] = {}
        for one in at_settings([condition], settings):
            for item in excess_of(one):
                known = found.get(item.quantity)
                if known is None or abs(item.value - item.bound) > abs(known.value - known.bound):
                    found[item.quantity] = item
        return list(found.values())

    return excess


@dataclass(frozen=True, slots=True)
class Combined:
    """The measurements of one candidate at all settings, as if they were one.

    Attributes
    ----------
    condition
        The candidate, without the settings.
    parts
        Its measurement at each setting.
    combine
        What becomes of them.
    worst_is_least
        Whether the goal is a maximum, of which the least is the worst.
    """

    condition: Condition
    parts: tuple[Measured, ...]
    combine: Combine
    worst_is_least: bool

    @property
    def outcomes(self) -> Sequence[object]:
        """Every trial at every setting, whatever its status."""
        return [outcome for part in self.parts for outcome in part.outcomes]

    def values(self, objective: str) -> FloatArray:
        """Return the combined value of each round of repeats, shape (rounds,).

        The n-th accepted trials of all settings make the n-th value; trials are independent, so that these values
        scatter as the sum (or mean) does. Of "worst" they are those of the setting with the worst mean: the worst of
        each round would be biased by the noise. None without an accepted trial at every setting.
        """
        each = [part.values(objective) for part in self.parts]
        if min(len(values) for values in each) == 0:
            return np.empty(0)
        if self.combine == "worst":
            return each[self._worst(each)]
        rounds = np.stack([values[: min(map(len, each))] for values in each])
        return np.asarray(rounds.sum(axis=0) if self.combine == "sum" else rounds.mean(axis=0))

    def truncation(self, objective: str) -> float:
        """Return what cut cycles may have done to the mean of the combined value."""
        each = [part.truncation(objective) for part in self.parts]
        if self.combine == "worst":
            return max(each)
        return sum(each) if self.combine == "sum" else sum(each) / len(each)

    @property
    def mountings(self) -> Numbers:
        """The mounting of each round where all settings share it; None elsewhere."""
        rounds = min(len(part.mountings) for part in self.parts)
        each = [tuple(part.mountings[:rounds]) for part in self.parts]
        return each[0] if len(set(each)) == 1 and self.combine != "worst" else (None,) * rounds

    def _worst(self, each: Sequence[FloatArray]) -> int:
        means = [float(values.mean()) for values in each]
        return int(np.argmin(means) if self.worst_is_least else np.argmax(means))


class OverSettings:
    """A session that measures every candidate at all settings.

    Parameters
    ----------
    session
        What measures.
    settings
        Values that each candidate gets in turn.
    combine
        How the values of the settings become one.
    goal
        Direction of the objective; tells which is the worst.
    """

    def __init__(
        self,
        session: Measures,
        settings: Sequence[Condition],
        combine: Combine,
        goal: Literal["maximise", "minimise"],
    ) -> None:
        self._session = session
        self._settings = settings
        self._combine = combine
        self._goal = goal

    def measure(
        self,
        conditions: Sequence[Condition],
        *,
        role: Role = "measure",
        repeats: RepeatRule | None = None,
        order: Literal["shuffled", "as-listed"] = "shuffled",
    ) -> Sequence[Combined]:
        """Measure each candidate at each setting, all of them shuffled; one answer a candidate."""
        asked = at_settings(conditions, self._settings)
        found = list(self._session.measure(asked, role=role, repeats=repeats, order=order))
        count = len(self._settings)
        return [
            Combined(
                condition,
                tuple(found[place * count : (place + 1) * count]),
                self._combine,
                self._goal == "maximise",
            )
            for place, condition in enumerate(conditions)
        ]
