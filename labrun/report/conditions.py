"""What each condition of a run gave: its trials, and the mean of every objective with its error."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from labrun.report.data import FloatArray, Point, RunView
from labrun.search.leaders import leading_conditions
from labrun.spec import Experiment, Value, condition_key
from labrun.store import TrialOutcome


@dataclass(frozen=True, slots=True)
class ConditionResult:
    """One condition with its trials, references apart.

    Attributes
    ----------
    condition
        Its values.
    trials
        All of them, rejected and failed ones too.
    points
        By objective, the accepted values; objectives without one are left out.
    best
        Whether this is the honest best.
    """

    condition: Mapping[str, Value]
    trials: tuple[TrialOutcome, ...]
    points: Mapping[str, Point]
    best: bool = False

    @property
    def accepted(self) -> int:
        """Number of accepted trials."""
        return sum(trial.status == "done" for trial in self.trials)

    @property
    def recorded_s(self) -> float:
        """How long the accepted trials were recorded, s."""
        return sum(trial.duration_s for trial in self.trials if trial.status == "done")

    def to_json(self, units: Mapping[str, str]) -> dict[str, Any]:
        """Return it JSON-ready; `units` are those of the objectives."""
        objectives = {
            name: {
                "mean": point.mean,
                "ci95": point.ci95,
                "standard_error": standard_error(point),
                "n": len(point.values),
                "unit": units.get(name, ""),
            }
            for name, point in self.points.items()
        }
        return {
            "condition": dict(self.condition),
            "accepted": self.accepted,
            "rejected_or_failed": len(self.trials) - self.accepted,
            "best": self.best,
            "objectives": objectives,
        }


@dataclass(frozen=True, slots=True)
class _Asked:
    """A point in the form the ranking of leaders takes."""

    point: Point

    @property
    def condition(self) -> Mapping[str, Value]:
        return self.point.condition

    @property
    def outcomes(self) -> Sequence[object]:
        return self.point.trials

    def values(self, objective: str) -> FloatArray:  # noqa: ARG002 (a point has one objective)
        return self.point.values


def condition_results(view: RunView) -> list[ConditionResult]:
    """Return what every condition gave, in the order of `in_order`."""
    groups: dict[object, list[TrialOutcome]] = {}
    for outcome in view.run.outcomes:
        if outcome.role != "reference":
            groups.setdefault(condition_key(outcome.condition), []).append(outcome)
    means = {
        name: {condition_key(point.condition): point for point in view.points(name)}
        for name in view.experiment.objectives
    }
    winner = condition_key(view.best.parameters) if view.best is not None else None
    results = {
        key: ConditionResult(
            trials[0].condition,
            tuple(trials),
            {name: points[key] for name, points in means.items() if key in points},
            best=key == winner,
        )
        for key, trials in groups.items()
    }
    ordered = in_order(view.experiment, (result.condition for result in results.values()))
    return [results[condition_key(condition)] for condition in ordered]


def most_promising(view: RunView, results: Sequence[ConditionResult]) -> list[ConditionResult]:
    """Return the conditions by the goal, the most promising first; those without a value of it last.

    Without a goal they stay as they are.
    """
    goal = view.experiment.goal
    if goal is None:
        return list(results)
    name, direction = goal
    found = {condition_key(r.condition): r for r in results if name in r.points}
    asked = [_Asked(result.points[name]) for result in found.values()]
    order = leading_conditions(asked, name, direction, len(asked))
    ranked = [found[condition_key(condition)] for condition in order]
    return ranked + [result for result in results if name not in result.points]


def standard_error(point: Point) -> float | None:
    """Return the standard error of a point's mean from its own trials; None for a single one."""
    n = len(point.values)
    return float(point.values.std(ddof=1)) / math.sqrt(n) if n > 1 else None


def in_order(experiment: Experiment, conditions: Iterable[Mapping[str, Value]]) -> list[Mapping[str, Value]]:
    """Return conditions as a closed-loop experiment lists them, those of others by ascending values."""
    listed = [] if experiment.track is None else [condition_key(c) for c in experiment.track.conditions]
    places = {key: place for place, key in enumerate(listed)}

    def rank(condition: Mapping[str, Value]) -> tuple[int, list[tuple[int, float, str]]]:
        place = places.get(condition_key(condition), len(places))
        return place, [_sortable(value) for value in condition.values()]

    return sorted(conditions, key=rank)


def varying(conditions: Iterable[Mapping[str, Value]]) -> list[str]:
    """Return the names whose value is not the same in all conditions; all names where none varies."""
    found = list(conditions)
    names = list(dict.fromkeys(name for condition in found for name in condition))
    return [name for name in names if len({condition.get(name) for condition in found}) > 1] or names


def _sortable(value: Value) -> tuple[int, float, str]:
    return (1, 0.0, value) if isinstance(value, str) else (0, float(value), "")
