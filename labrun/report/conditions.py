"""What each condition of a run gave: its trials, and the mean of every objective with its error."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from labrun.experiment import Condition, Experiment, Value, condition_key, varying
from labrun.report.data import Point, RunView, by_condition
from labrun.report.page import PageTable
from labrun.report.text import (
    counted,
    decimal_text,
    decimals_for,
    label,
    named_condition,
    spaced,
    value_text,
    with_unit,
)
from labrun.search import combined_text, combined_values, leading_conditions, mean_error
from labrun.store import TrialOutcome

_Key = tuple[tuple[str, Value], ...]
_LEADERS_SHOWN = 12
_CONDITIONS_SHOWN = 60


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
    combined
        Of an experiment over several settings: the goal's objective over all settings of this candidate.
    """

    condition: Mapping[str, Value]
    trials: tuple[TrialOutcome, ...]
    points: Mapping[str, Point]
    best: bool = False
    combined: Point | None = None

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
                **({"at_least": True} if point.at_least else {}),
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
            **(
                {}
                if self.combined is None
                else {"combined": {"mean": self.combined.mean, "ci95": self.combined.ci95}}
            ),
        }


def condition_results(view: RunView) -> list[ConditionResult]:
    """Return what every condition gave, in the order of `in_order`."""
    groups = by_condition(outcome for outcome in view.run.outcomes if outcome.role != "reference")
    means = {
        name: {condition_key(point.condition): point for point in view.points(name)}
        for name in view.experiment.objectives
    }
    winner = None if view.best is None else view.best.parameters.items()
    results = {
        key: ConditionResult(
            trials[0].condition,
            tuple(trials),
            {name: points[key] for name, points in means.items() if key in points},
            best=winner is not None
            and winner <= dict(trials[0].condition).items(),  # it may be at several settings
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
    if view.experiment.over:
        return _by_candidate(view, results)
    by_condition = {condition_key(r.condition): r for r in results if name in r.points}
    points = (result.points[name] for result in by_condition.values())
    order = leading_conditions(
        ((point.condition, point.values, point.truncation) for point in points), direction
    )
    ranked = [by_condition[condition_key(condition)] for condition in order]
    return ranked + [result for result in results if name not in result.points]


def candidate_points(view: RunView, *, roles: Sequence[str] = ("measure", "fresh", "confirm")) -> list[Point]:
    """Return the goal's objective of every candidate over all settings, as `labrun.search.Combined` makes it.

    The condition of a point is the candidate's, without the settings. Candidates without an accepted trial at every
    setting are left out.
    """
    experiment = view.experiment
    if experiment.goal is None:
        return []
    name, direction = experiment.goal
    settings = math.prod(len(values) for values in experiment.over.values())
    groups: dict[_Key, list[Point]] = {}
    for point in view.points(name, roles=roles):
        groups.setdefault(condition_key(_own(experiment, point.condition)), []).append(point)
    points = []
    for parts in groups.values():
        if len(parts) < settings:
            continue
        values = combined_values(
            [part.values for part in parts], experiment.combine, worst_is_least=direction == "maximise"
        )
        cut = [part.truncation for part in parts]
        truncation = {"worst": max(cut), "sum": sum(cut), "mean": sum(cut) / len(cut)}[experiment.combine]
        own = _own(experiment, parts[0].condition)
        points.append(Point(own, values, parts[0].trials[: len(values)], truncation=truncation))
    return points


def _by_candidate(view: RunView, results: Sequence[ConditionResult]) -> list[ConditionResult]:
    """Return all settings of the most promising candidate, then those of the next; each with its combined value."""
    points = {condition_key(point.condition): point for point in candidate_points(view)}
    measured = ((point.condition, point.values, point.truncation) for point in points.values())
    direction = "minimise" if view.experiment.goal is None else view.experiment.goal[1]
    groups: dict[_Key, list[ConditionResult]] = {}
    for result in results:
        groups.setdefault(condition_key(_own(view.experiment, result.condition)), []).append(result)
    leading = [condition_key(condition) for condition in leading_conditions(measured, direction)]
    others = [key for key in groups if key not in points]
    return [
        replace(member, combined=points.get(key)) for key in (*leading, *others) for member in groups[key]
    ]


def _own(experiment: Experiment, condition: Mapping[str, Value]) -> dict[str, Value]:
    """Return a condition without the settings that all candidates share."""
    return {name: value for name, value in condition.items() if name not in experiment.over}


def standard_error(point: Point) -> float | None:
    """Return the standard error of a point's mean from its own trials; None for a single one."""
    error = None if point.at_least else mean_error(point.values, point.mountings)
    return None if error is None else error[0]


def in_order(experiment: Experiment, conditions: Iterable[Mapping[str, Value]]) -> list[Mapping[str, Value]]:
    """Return conditions as a closed-loop experiment lists them, those of others by ascending values."""
    listed = [] if experiment.track is None else [condition_key(c) for c in experiment.track.conditions]
    places = {key: index for index, key in enumerate(listed)}

    def rank(condition: Mapping[str, Value]) -> tuple[int, list[tuple[int, float, str]]]:
        position = places.get(condition_key(condition), len(places))
        return position, [_sortable(value) for value in condition.values()]

    return sorted(conditions, key=rank)


def _sortable(value: Value) -> tuple[int, float, str]:
    return (1, 0.0, value) if isinstance(value, str) else (0, float(value), "")


def conditions_context(view: RunView) -> Mapping[str, Any]:
    """Return the tables of a page: the leaders and their fresh repeats where there is a goal, else all conditions."""
    goal = view.experiment.goal
    if goal is not None and view.points(goal[0]):
        return {"fresh": _fresh(view, *goal), "best": _leaders(view, goal[0]), "every": None}
    return {"fresh": None, "best": None, "every": _every(view)}


def _leaders(view: RunView, name: str) -> Mapping[str, Any]:
    results = [result for result in condition_results(view) if name in result.points]
    leading = most_promising(view, results)[:_LEADERS_SHOWN]
    others = [other for other in view.experiment.objectives if other != name]
    keys = _names(result.condition for result in leading)
    decimals = {each: _decimals(leading, each) for each in (name, *others)}
    over = combined_text(view.experiment)
    together = decimals_for(
        standard_error(result.combined) for result in leading if result.combined is not None
    )
    rows = [
        [
            str(rank),
            *_values(result.condition, keys),
            *_mean(result.points[name], decimals[name]),
            *(
                _mean(result.points[other], decimals[other])[0] if other in result.points else ""
                for other in others
            ),
            *([] if not over else _mean(result.combined, together)[:1] if result.combined else [""]),
        ]
        for rank, result in enumerate(leading, start=1)
    ]
    marked = [index for index, result in enumerate(leading) if result.best]
    columns = ["", *_labels(keys, view), _quantity(name, view.unit), "standard error", "n"]
    columns += [_quantity(other, view.unit_of(other)) for other in others]
    columns += [with_unit(over, view.unit)] if over else []
    return {
        "table": PageTable(columns, rows, words=(), marked=marked),
        "shown": f"The {len(leading)} most promising of {counted(len(results), 'condition')}",
        "marked": bool(marked),
    }


def _fresh(view: RunView, name: str, direction: str) -> tuple[PageTable, str] | None:
    points = view.points(name, roles=("fresh",))
    if len(points) < 2:
        return None
    points.sort(key=lambda point: point.mean, reverse=direction == "maximise")
    keys = _names(point.condition for point in points)
    decimals = decimals_for(standard_error(point) for point in points)
    rows = [
        [
            *_values(point.condition, keys),
            *_mean(point, decimals),
            " to ".join(decimal_text(end, decimals) for end in point.ci95 or ()),
        ]
        for point in points
    ]
    winner = None if view.best is None else condition_key(view.best.parameters)
    marked = [index for index, point in enumerate(points) if condition_key(point.condition) == winner]
    columns = [*_labels(keys, view), _quantity(name, view.unit), "standard error", "n", "95 % interval"]
    return PageTable(columns, rows, words=(), marked=marked), _separation(points, direction == "maximise")


def _separation(points: Sequence[Point], maximise: bool) -> str:
    """Tell whether the first of the leaders is better than the second beyond chance (Welch's interval)."""
    first, second = points[0], points[1]
    if min(len(first.values), len(second.values)) < 2:
        return "Too few fresh repeats to tell the leaders apart."
    if float(first.values.std()) == 0.0 and float(second.values.std()) == 0.0:
        return "The fresh repeats of the two first leaders do not scatter at all."
    from scipy.stats import ttest_ind  # slow to import

    difference = ttest_ind(first.values, second.values, equal_var=False).confidence_interval(0.95)
    low, high = float(difference.low), float(difference.high)
    range_text = f"(95 % interval of the difference {low:.3g} to {high:.3g})"
    if (low if maximise else -high) > 0:
        return f"The first leads the second beyond chance {range_text}."
    return (
        f"These repeats do not distinguish the first two {range_text}: their order may be chance, what the winner "
        "reaches is not."
    )


def _every(view: RunView) -> Mapping[str, Any]:
    objectives = list(view.experiment.objectives)
    results = condition_results(view)
    decimals = {name: _decimals(results, name) for name in objectives}
    keys = varying(result.condition for result in results)
    repeated = {
        name: any(
            standard_error(result.points[name]) is not None for result in results if name in result.points
        )
        for name in objectives
    }
    rows = []
    for result in results[:_CONDITIONS_SHOWN]:
        row = _values(result.condition, keys)
        for name in objectives:
            point = result.points.get(name)
            cells = ["", ""] if point is None else _mean(point, decimals[name])[:2]
            row += cells if repeated[name] else cells[:1]
        spoiled = str(len(result.trials) - result.accepted)
        rows.append([*row, str(result.accepted), spoiled, f"{result.recorded_s:.4g}"])
    columns = list(_labels(keys, view))
    for name in objectives:
        columns += [_quantity(name, view.unit_of(name)), *(["standard error"] if repeated[name] else [])]
    left = len(results) - len(rows)
    alike = (
        {name: value for name, value in results[0].condition.items() if name not in keys} if results else {}
    )
    return {
        "table": PageTable([*columns, "accepted", "rejected or failed", "recorded (s)"], rows, words=()),
        "alike": named_condition(alike, view.experiment.units) if alike else "",
        "more": counted(left, "more condition") if left else "",
    }


def _names(conditions: Iterable[Condition]) -> list[str]:
    return list(dict.fromkeys(name for condition in conditions for name in condition))


def _labels(names: Sequence[str], view: RunView) -> list[str]:
    return [label(name, view.experiment.units) for name in names]


def _values(condition: Condition, names: Sequence[str]) -> list[str]:
    return [value_text(condition[name]) if name in condition else "" for name in names]


def _quantity(name: str, unit: str) -> str:
    return with_unit(f"mean {spaced(name)}", unit)


def _decimals(results: Iterable[ConditionResult], objective: str) -> int | None:
    return decimals_for(
        standard_error(result.points[objective]) for result in results if objective in result.points
    )


def _mean(point: Point, decimals: int | None) -> list[str]:
    error = standard_error(point)
    if point.at_least:
        return [f"> {decimal_text(point.mean, decimals)}", "", str(len(point.values))]
    return [decimal_text(point.mean, decimals), decimal_text(error, decimals), str(len(point.values))]
