"""Tables of conditions: the leaders' fresh repeats, and the best or all conditions with means and errors."""

from collections.abc import Iterable, Mapping, Sequence

from labrun.report.conditions import (
    ConditionResult,
    condition_results,
    most_promising,
    standard_error,
    varying,
)
from labrun.report.data import Point, RunView
from labrun.report.html_elements import Content, Html, element, joined, paragraph, section, table
from labrun.report.report_source import ReportSource
from labrun.report.text import counted, decimal_text, decimals_for, label, named_condition, spaced, value_text
from labrun.spec import Value, condition_key

_LEADERS_SHOWN = 12
_CONDITIONS_SHOWN = 60


def conditions_section(source: ReportSource) -> Html | None:
    """Return the section on conditions; None before any accepted trial."""
    if not source.accepted:
        return None
    view, goal = source.view, source.experiment.goal
    if goal is not None and view.points(goal[0]):
        return section("conditions", "Best conditions", _fresh(source), _best(source))
    return section("conditions", "Conditions", _all(source))


def _best(source: ReportSource) -> Html:
    view, goal = source.view, source.experiment.goal
    if goal is None:
        return Html("")
    name = goal[0]
    results = [result for result in condition_results(view) if name in result.points]
    leading = most_promising(view, results)[:_LEADERS_SHOWN]
    others = [other for other in source.experiment.objectives if other != name]
    keys = _names(result.points[name] for result in leading)
    rows: list[list[Content]] = []
    decimals = {each: _decimals(leading, each) for each in (name, *others)}
    for rank, result in enumerate(leading, start=1):
        row: list[Content] = [str(rank), *_values(result.condition, keys)]
        row += _mean(result.points[name], decimals[name])
        row += [
            _mean(result.points[other], decimals[other])[0] if other in result.points else ""
            for other in others
        ]
        rows.append(row)
    marked = [place for place, result in enumerate(leading) if result.best]
    columns = ["", *_labels(keys, view), _quantity(name, view.unit), "standard error", "n"]
    columns += [_quantity(other, view.unit_of(other)) for other in others]
    again = "; the honest best, marked, was measured again for that reason" if marked else ""
    shown = f"The {len(leading)} most promising of {counted(len(results), 'condition')}"
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
    decimals = decimals_for(standard_error(point) for point in points)
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
    results = condition_results(view)
    if not results:
        return paragraph("Only reference trials so far: no condition has been measured yet.")
    decimals = {name: _decimals(results, name) for name in objectives}
    keys = varying(result.condition for result in results)
    rows: list[list[Content]] = []
    for result in results[:_CONDITIONS_SHOWN]:
        row: list[Content] = [*_values(result.condition, keys)]
        for name in objectives:
            point = result.points.get(name)
            row += _mean(point, decimals[name])[:2] if point is not None else ["", ""]
        row += [str(result.accepted), str(len(result.trials) - result.accepted), f"{result.recorded_s:.4g}"]
        rows.append(row)
    columns = list(_labels(keys, view))
    for name in objectives:
        columns += [_quantity(name, view.unit_of(name)), "standard error"]
    columns += ["accepted", "rejected or failed", "recorded (s)"]
    left = len(results) - len(rows)
    more = f"{counted(left, 'more condition')} in labrun export {source.run.path} --to csv" if left else None
    alike = {name: value for name, value in results[0].condition.items() if name not in keys}
    same = f"The same in all: {named_condition(alike, view.experiment.units)}." if alike else None
    notes = [paragraph(text, class_="note") for text in (same, more) if text]
    return joined([table(columns, rows, words=()), *notes])


def _names(points: Iterable[Point]) -> list[str]:
    return list(dict.fromkeys(name for point in points for name in point.condition))


def _labels(names: Sequence[str], view: RunView) -> list[str]:
    return [label(name, view.experiment.units) for name in names]


def _values(condition: Mapping[str, Value], names: Sequence[str]) -> list[Content]:
    return [value_text(condition[name]) if name in condition else "" for name in names]


def _quantity(name: str, unit: str) -> str:
    return f"mean {spaced(name)} ({unit})" if unit else f"mean {spaced(name)}"


def _decimals(results: Iterable[ConditionResult], objective: str) -> int | None:
    points = (result.points.get(objective) for result in results)
    return decimals_for(standard_error(point) for point in points if point is not None)


def _mean(point: Point, decimals: int | None) -> list[Content]:
    error = standard_error(point)
    return [decimal_text(point.mean, decimals), decimal_text(error, decimals), str(len(point.values))]
