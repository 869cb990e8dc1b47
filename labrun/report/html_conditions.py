"""Tables of conditions: the leaders' fresh repeats, and the best or all conditions with means and errors."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from labrun.report.data import FloatArray, Point, RunView
from labrun.report.html_elements import Content, Html, element, joined, paragraph, section, table
from labrun.report.html_words import counted, decimal_text, decimals_for, spaced
from labrun.report.report_source import ReportSource
from labrun.report.words import label, value_text
from labrun.search.leaders import condition_key, leading_conditions
from labrun.spec.experiment import Value
from labrun.store.trial import TrialOutcome

_LEADERS_SHOWN = 12
_CONDITIONS_SHOWN = 60


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


def conditions_section(source: ReportSource) -> Html | None:
    """Return the section on conditions; None before any accepted trial."""
    if not source.accepted:
        return None
    view, goal = source.view, source.experiment.goal
    if goal is not None and view.points(goal[0]):
        return section("conditions", "Best conditions", _fresh(source), _best(source))
    return section("conditions", "Conditions", _all(source))


def standard_error(point: Point) -> float | None:
    """Return the standard error of a point's mean from its own trials; None for a single one."""
    n = len(point.values)
    return float(point.values.std(ddof=1)) / math.sqrt(n) if n > 1 else None


def _best(source: ReportSource) -> Html:
    view, goal = source.view, source.experiment.goal
    if goal is None:
        return Html("")
    name, direction = goal
    points = {condition_key(point.condition): point for point in view.points(name)}
    asked = [_Asked(point) for point in points.values()]
    order = [condition_key(c) for c in leading_conditions(asked, name, direction, _LEADERS_SHOWN)]
    others = [other for other in source.experiment.objectives if other != name]
    means = {
        other: {condition_key(point.condition): point for point in view.points(other)} for other in others
    }
    keys = _names(points[key] for key in order)
    rows: list[list[Content]] = []
    marked = []
    decimals = _decimals(points[key] for key in order)
    others_decimals = {
        other: _decimals(means[other][key] for key in order if key in means[other]) for other in others
    }
    for rank, key in enumerate(order, start=1):
        point = points[key]
        row: list[Content] = [str(rank), *_values(point.condition, keys), *_mean(point, decimals)]
        row += [
            _mean(means[other][key], others_decimals[other])[0] if key in means[other] else ""
            for other in others
        ]
        rows.append(row)
        if source.best is not None and key == condition_key(source.best.parameters):
            marked.append(rank - 1)
    columns = ["", *_labels(keys, view), _quantity(name, view.unit), "standard error", "n"]
    columns += [_quantity(other, view.unit_of(other)) for other in others]
    again = "; the honest best, marked, was measured again for that reason" if marked else ""
    shown = f"The {len(order)} most promising of {counted(len(points), 'condition')}"
    return joined(
        [
            element("h3", "All accepted trials together"),
            table(columns, rows, words=(), marked=marked),
            paragraph(
                f"{shown}: means of all accepted trials but references, ordered with each mean drawn towards the mean "
                "of all by the share of it that is noise. Standard errors are each condition's own. Whatever leads a "
                f"list like this is on average too good{again}.",
                class_="note",
            ),
        ]
    )


def _fresh(source: ReportSource) -> Html | None:
    view, goal = source.view, source.experiment.goal
    if goal is None:
        return None
    points = view.points(goal[0], roles=("fresh",))
    if len(points) < 2:
        return None
    points.sort(key=lambda point: point.mean, reverse=goal[1] == "maximise")
    keys = _names(points)
    rows: list[list[Content]] = []
    decimals = _decimals(points)
    for point in points:
        ends = [decimal_text(end, decimals) for end in point.ci95 or ()]
        rows.append([*_values(point.condition, keys), *_mean(point, decimals), " to ".join(ends)])
    winner = source.best.parameters if source.best is not None else None
    marked = [
        n
        for n, p in enumerate(points)
        if winner is not None and condition_key(p.condition) == condition_key(winner)
    ]
    columns = [*_labels(keys, view), _quantity(goal[0], view.unit), "standard error", "n", "95 % interval"]
    return joined(
        [
            element("h3", "Fresh repeats of the leaders"),
            table(columns, rows, words=(), marked=marked),
            paragraph(_separation(points, goal[1] == "maximise"), class_="note"),
        ]
    )


def _separation(points: Sequence[Point], maximise: bool) -> str:
    """Tell whether the first of the leaders is better than the second beyond chance (Welch's interval)."""
    first, second = points[0], points[1]
    if min(len(first.values), len(second.values)) < 2:
        return "Too few fresh repeats to tell the leaders apart."
    if float(first.values.std()) == 0.0 and float(second.values.std()) == 0.0:
        return "The fresh repeats of the two first leaders do not scatter at all."
    from scipy.stats import ttest_ind

    found = ttest_ind(first.values, second.values, equal_var=False).confidence_interval(0.95)
    low, high = float(found.low), float(found.high)
    margin = low if maximise else -high
    if margin > 0:
        return f"The first leads the second beyond chance (95 % interval of the difference {low:.3g} to {high:.3g})."
    return (
        f"The first two cannot be told apart by these repeats (95 % interval of the difference {low:.3g} to "
        f"{high:.3g}): their order may be chance, what the winner reaches is not."
    )


def _all(source: ReportSource) -> Html:
    view = source.view
    objectives = list(source.experiment.objectives)
    groups: dict[object, list[TrialOutcome]] = {}
    for outcome in source.run.outcomes:
        if outcome.role != "reference":
            groups.setdefault(condition_key(outcome.condition), []).append(outcome)
    ordered = sorted(groups.values(), key=lambda trials: [_sortable(v) for v in trials[0].condition.values()])
    by_objective = {
        name: {condition_key(point.condition): point for point in view.points(name)} for name in objectives
    }
    decimals = {name: _decimals(points.values()) for name, points in by_objective.items()}
    keys = list(dict.fromkeys(name for trials in ordered for name in trials[0].condition))
    rows: list[list[Content]] = []
    for trials in ordered[:_CONDITIONS_SHOWN]:
        condition = trials[0].condition
        row: list[Content] = [*_values(condition, keys)]
        for name in objectives:
            point = by_objective[name].get(condition_key(condition))
            row += _mean(point, decimals[name])[:2] if point is not None else ["", ""]
        accepted = [trial for trial in trials if trial.status == "done"]
        row += [str(len(accepted)), str(len(trials) - len(accepted))]
        row.append(f"{sum(trial.duration_s for trial in accepted):.4g}")
        rows.append(row)
    columns = list(_labels(keys, view))
    for name in objectives:
        columns += [_quantity(name, view.unit_of(name)), "standard error"]
    columns += ["accepted", "rejected or failed", "recorded (s)"]
    left = len(ordered) - len(rows)
    more = f"{counted(left, 'more condition')} in labrun export {source.run.path} --to csv" if left else None
    return joined([table(columns, rows, words=()), paragraph(more, class_="note") if more else None])


def _sortable(value: Value) -> tuple[int, float, str]:
    return (1, 0.0, value) if isinstance(value, str) else (0, float(value), "")


def _names(points: Iterable[Point]) -> list[str]:
    return list(dict.fromkeys(name for point in points for name in point.condition))


def _labels(names: Sequence[str], view: RunView) -> list[str]:
    return [label(name, view.experiment.units) for name in names]


def _values(condition: Mapping[str, Value], names: Sequence[str]) -> list[Content]:
    return [value_text(condition[name]) if name in condition else "" for name in names]


def _quantity(name: str, unit: str) -> str:
    return f"mean {spaced(name)} ({unit})" if unit else f"mean {spaced(name)}"


def _decimals(points: Iterable[Point]) -> int | None:
    return decimals_for(standard_error(point) for point in points)


def _mean(point: Point, decimals: int | None) -> list[Content]:
    error = standard_error(point)
    return [decimal_text(point.mean, decimals), decimal_text(error, decimals), str(len(point.values))]
