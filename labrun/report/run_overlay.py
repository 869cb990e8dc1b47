"""The figure of a plain run: traces of every condition, and its objectives with their repeats."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labrun.report.data import Point, RunView
from labrun.report.style import COLOURS, SOFT, heading, new_figure, save, zero_line
from labrun.report.words import condition_text, interval_text
from labrun.search.leaders import condition_key
from labrun.spec.experiment import Value
from labrun.store.trial import TrialOutcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TITLE_WIDTH = 48
_MOST_CONDITIONS = 12
_MOST_REPEATS = 8
_COLUMNS = 3


def draw_plain_run(view: RunView, path: Path) -> Path:
    """Draw a run of listed conditions and save it: traces by condition, then the objective over all of them."""
    groups = groups_of(view)
    channel = view.channel
    shown = list(groups.values())[:_MOST_CONDITIONS] if channel is not None else []
    points = view.points(view.objective) if view.objective is not None else []
    columns = min(_COLUMNS, max(len(shown), 1))
    rows = -(-len(shown) // columns) if shown else 0
    heights = [1.75 * rows] * bool(rows) + [2.6] * bool(points)
    with new_figure(9.6, sum(heights) + 0.9) as figure:
        parts: Any = (
            figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False) if heights else []
        )
        if rows and channel is not None:
            grid = parts[0][0].subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
            for number, axes in enumerate(grid.flat):
                if number >= len(shown):
                    axes.set_visible(False)
                    continue
                _traces(axes, view, shown[number], channel)
                if number + columns >= len(shown):
                    axes.set_xlabel("time (s)")
                    axes.tick_params(labelbottom=True)
                if number % columns == 0:
                    axes.set_ylabel(view.trace_label)
        if points:
            objective_panel(parts[-1][0].subplots(1, 1), view, points)
        heading(figure, view.experiment.title, _subtitle(view, groups, len(shown)))
        return save(figure, path)


def groups_of(view: RunView) -> dict[object, list[TrialOutcome]]:
    """Return the accepted trials of every condition, in the order of the conditions' values."""
    groups: dict[object, list[TrialOutcome]] = {}
    for outcome in view.run.outcomes:
        if outcome.status == "done" and outcome.role != "reference":
            groups.setdefault(condition_key(outcome.condition), []).append(outcome)
    ordered = sorted(
        groups, key=lambda key: [_sortable(value) for value in groups[key][0].condition.values()]
    )
    return {key: groups[key] for key in ordered}


def _sortable(value: Value) -> tuple[int, float, str]:
    return (1, 0.0, value) if isinstance(value, str) else (0, float(value), "")


def _subtitle(view: RunView, groups: dict[object, list[TrialOutcome]], shown: int) -> str:
    text = f"{len(groups)} conditions, {sum(len(trials) for trials in groups.values())} accepted trials"
    if shown < len(groups):
        text += f" (traces of the first {shown} conditions)"
    best = view.best
    if best is None:
        return text
    value = interval_text(best.value, best.ci95, best.unit)
    return f"{text}.  Best: {best.objective_name} {value} at {condition_text(best.parameters)}"


def _traces(axes: "Axes", view: RunView, trials: Sequence[TrialOutcome], channel: str) -> None:
    repeats = trials[:_MOST_REPEATS]
    for number, trial in enumerate(repeats):
        trace = view.trace(trial, channel)
        if trace is not None:
            axes.plot(*trace, color=COLOURS[number % len(COLOURS)], linewidth=0.8, alpha=0.75)
    axes.set_title(condition_title(view, trials[0]))
    count = (
        f"{len(repeats)} repeats"
        if len(repeats) == len(trials)
        else f"{len(repeats)} of {len(trials)} repeats"
    )
    axes.text(
        0.985, 0.97, count, transform=axes.transAxes, ha="right", va="top", fontsize=7.5, color="#666666"
    )
    axes.set_xlim(0, max(trial.duration_s for trial in repeats))
    zero_line(axes)


def condition_title(view: RunView, trial: TrialOutcome) -> str:
    """Return a trial's condition with units, folded to fit over a panel."""
    units = view.experiment.units
    parts = [
        condition_text({k: v}) + (f" {units[k]}" if k in units else "") for k, v in trial.condition.items()
    ]
    return textwrap.fill(", ".join(parts), _TITLE_WIDTH)


def objective_panel(axes: "Axes", view: RunView, points: Sequence[Point]) -> None:
    """Draw the objective over all conditions: single trials, means, intervals."""
    ordered = sorted(points, key=lambda point: [_sortable(value) for value in point.condition.values()])
    for position, point in enumerate(ordered):
        spread = np.linspace(-0.16, 0.16, len(point.values)) if len(point.values) > 1 else np.zeros(1)
        axes.plot(
            position + spread, point.values, "o", color=SOFT, markersize=3.5, alpha=0.6, markeredgewidth=0
        )
        axes.plot([position - 0.22, position + 0.22], [point.mean] * 2, color=COLOURS[0], linewidth=2)
        if point.ci95 is not None:
            axes.plot([position] * 2, point.ci95, color=COLOURS[0], linewidth=1.2)
    varying = [name for name in ordered[0].condition if len({point.condition[name] for point in ordered}) > 1]
    names = [
        condition_text({name: point.condition[name] for name in varying or point.condition})
        for point in ordered
    ]
    if len(names) > _MOST_CONDITIONS:
        axes.set_xlabel("conditions, in ascending order")
        axes.set_xticks([])
    else:
        crowded = sum(len(name) for name in names) > 90
        axes.set_xticks(
            range(len(names)), names, rotation=20 if crowded else 0, ha="right" if crowded else "center"
        )
    axes.set_xlim(-0.6, len(ordered) - 0.4)
    axes.set_ylabel(f"{view.objective} ({view.unit})" if view.unit else str(view.objective))
    axes.set_title("mean and 95 % interval; dots are single trials")
    zero_line(axes)
