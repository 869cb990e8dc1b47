"""The figure of a plain run, and panels shared with others: traces, gait cycles, objectives with repeats."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrun.arrays import FloatArray
from labrun.experiment import Condition, condition_key, condition_text, varying
from labrun.report.conditions import in_order
from labrun.report.data import Point, RunView
from labrun.report.style import COLOURS, FAINT, SOFT, annotate_point, heading, new_figure, zero_line
from labrun.report.text import label, value_text, with_unit
from labrun.search import NUMBER
from labrun.store import TrialOutcome

_TITLE_WIDTH = 40
MOST_TRACED = 12
_MOST_REPEATS = 8
_UNEQUAL = 1.5
"""Times the shortest trial: a longer one does not fit its axis of time."""
_COLUMNS = 3
_WIDTH_IN = 9.6
_CHARACTERS_PER_IN = 10.0
PANEL_TITLE = "mean and 95 % interval; dots are single trials"


def draw_plain_run(view: RunView) -> Figure | None:
    """Draw a run of listed conditions: traces by condition, then the objective over all of them.

    Trials of unequal length, a few cycles of gaits of unequal frequency, share no axis of time: of them the mean cycle
    of each is drawn. None of a run that recorded no channel and has no objective: there is nothing to draw.
    """
    groups = groups_of(view)
    channel = view.channel
    shown = list(groups.values())[:MOST_TRACED] if channel is not None else []
    points = view.points(view.objective) if view.objective is not None else []
    columns = min(_COLUMNS, max(len(shown), 1))
    rows = -(-len(shown) // columns) if shown else 0
    heights = [1.75 * rows] * bool(rows) + [2.6] * bool(points)
    if not heights:
        return None
    with new_figure(_WIDTH_IN, sum(heights) + 0.9) as figure:
        parts: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)
        if rows and channel is not None:
            grid = parts[0][0].subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
            cycles = _cycles_of_all(view, shown, channel)
            for number, axes in enumerate(grid.flat):
                if number >= len(shown):
                    axes.set_visible(False)
                    continue
                if cycles is None:
                    _traces(axes, view, shown[number], channel)
                else:
                    _each_cycle(axes, cycles[number])
                # shared; trials of a single sample have no length
                axes.set_xlim(0, (max(_lengths_s(shown)) or 1) if cycles is None else 1)
                axes.set_title(condition_title(view, shown[number][0]))
                if number + columns >= len(shown):
                    axes.set_xlabel("time (s)" if cycles is None else "phase of the gait cycle")
                    axes.tick_params(labelbottom=True)
                if number % columns == 0:
                    axes.set_ylabel(view.trace_label)
        if points:
            axes = parts[-1][0].subplots(1, 1)
            objective_panel(axes, view, points, objective=str(view.objective), width_in=_WIDTH_IN)
            axes.set_title(PANEL_TITLE)
        heading(figure, view.experiment.title, _subtitle(view, groups, len(shown)))
    return figure


def groups_of(view: RunView) -> dict[object, list[TrialOutcome]]:
    """Return the accepted trials of every condition, in the order of `in_order`."""
    groups = view.accepted_trials
    ordered = in_order(view.experiment, (trials[0].condition for trials in groups.values()))
    return {key: groups[key] for key in map(condition_key, ordered)}


def _subtitle(view: RunView, groups: dict[object, list[TrialOutcome]], shown: int) -> str:
    counts = {len(trials) for trials in groups.values()}
    text = f"{len(groups)} conditions, {sum(len(trials) for trials in groups.values())} accepted trials"
    if len(counts) == 1 and (each := counts.pop()) > 1:
        text += f", {each} of each"
    if 0 < shown < len(groups):
        text += f" (traces of the first {shown} conditions)"
    return view.with_best(text)


def _traces(axes: Axes, view: RunView, trials: Sequence[TrialOutcome], channel: str) -> None:
    repeats = trials[:_MOST_REPEATS]
    for number, trial in enumerate(repeats):
        trace = view.trace(trial, channel)
        if trace is not None:
            axes.plot(*trace, color=COLOURS[number % len(COLOURS)], linewidth=0.8, alpha=0.75)
    zero_line(axes)


def _lengths_s(shown: Sequence[Sequence[TrialOutcome]]) -> list[float]:
    return [trial.duration_s for trials in shown for trial in trials]


def _cycles_of_all(
    view: RunView, shown: Sequence[Sequence[TrialOutcome]], channel: str
) -> list[FloatArray] | None:
    """Return the mean cycles of every condition; None if time says more: one length, or one without cycles."""
    lengths = _lengths_s(shown)
    if max(lengths) < _UNEQUAL * min(lengths):
        return None
    cycles = [cycles_of(view, trials[:_MOST_REPEATS], channel) for trials in shown]
    return (
        None if any(cycle is None for cycle in cycles) else [cycle for cycle in cycles if cycle is not None]
    )


def _each_cycle(axes: Axes, cycles: FloatArray) -> None:
    for number, cycle in enumerate(cycles):
        axes.plot(_PHASES, cycle, color=COLOURS[number % len(COLOURS)], linewidth=0.8, alpha=0.75)
    zero_line(axes)


def condition_title(view: RunView, trial: TrialOutcome) -> str:
    """Return a trial's condition with units, folded to fit over a panel."""
    units = view.experiment.units
    parts = (f"{name} = {value_text(value, units.get(name, ''))}" for name, value in trial.condition.items())
    whole = [part.replace(" ", "\u00a0") for part in parts]  # a line never ends within a value
    return textwrap.fill(", ".join(whole), _TITLE_WIDTH)


def objective_panel(
    axes: Axes, view: RunView, points: Sequence[Point], *, objective: str, width_in: float
) -> None:
    """Draw an objective over all conditions: single trials, means, intervals.

    Parameters
    ----------
    axes
        Where.
    view
        The run.
    points
        Of the objective.
    objective
        Its name.
    width_in
        Width of the panel, inches: how many conditions can be named side by side.
    """
    by_key = {condition_key(point.condition): point for point in points}
    conditions = in_order(view.experiment, (point.condition for point in points))
    ordered = [by_key[condition_key(condition)] for condition in conditions]
    if view.experiment.over:
        ticks = _draw_by_setting(axes, view, ordered)
    else:
        for position, point in enumerate(ordered):
            _draw_point(axes, position, point, COLOURS[0], 0.22)
        ticks = conditions
    differing = [NUMBER] if all(NUMBER in tick for tick in ticks) else varying(ticks)
    names = [", ".join(value_text(c[name]) for name in differing if name in c) for c in ticks]
    if len(names) > MOST_TRACED:
        axes.set_xlabel("conditions, in ascending order")
        axes.set_xticks([])
    else:
        crowded = max(len(name) for name in names) + 2 > _CHARACTERS_PER_IN * width_in / len(names)
        axes.set_xticks(
            range(len(names)), names, rotation=30 if crowded else 0, ha="right" if crowded else "center"
        )
        axes.set_xlabel(", ".join(label(name, view.experiment.units) for name in differing))
    axes.set_xlim(-0.6, len(ticks) - 0.4)
    axes.set_ylabel(with_unit(objective, view.unit_of(objective)))
    zero_line(axes)


def _draw_by_setting(axes: Axes, view: RunView, points: Sequence[Point]) -> list[Condition]:
    """Draw the settings of each candidate side by side, a colour a setting; return the candidates."""
    over = view.experiment.over
    candidates: dict[object, Condition] = {}
    settings: dict[object, Condition] = {}
    for point in points:
        own = {name: value for name, value in point.condition.items() if name not in over}
        setting = {name: value for name, value in point.condition.items() if name in over}
        candidates.setdefault(condition_key(own), own)
        settings.setdefault(condition_key(setting), setting)
    places, colours = list(candidates), list(settings)
    step = 0.8 / max(len(colours), 1)
    for point in points:
        own = {name: value for name, value in point.condition.items() if name not in over}
        setting = {name: value for name, value in point.condition.items() if name in over}
        number = colours.index(condition_key(setting))
        at = places.index(condition_key(own)) + (number - (len(colours) - 1) / 2) * step
        _draw_point(axes, at, point, COLOURS[number % len(COLOURS)], 0.36 * step)
    for number, condition in enumerate(settings.values()):
        text = condition_text(condition, view.experiment.units)
        axes.plot([], [], color=COLOURS[number % len(COLOURS)], linewidth=2, label=text)
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=min(len(colours), 4), frameon=False, fontsize=8
    )
    return list(candidates.values())


def _draw_point(axes: Axes, at: float, point: Point, colour: str, half: float) -> None:
    """Draw single trials, mean and interval of a condition, so far to both sides."""
    spread = 0.7 * half * np.linspace(-1.0, 1.0, len(point.values)) if len(point.values) > 1 else np.zeros(1)
    axes.plot(at + spread, point.values, "o", color=SOFT, markersize=3.5, alpha=0.6, markeredgewidth=0)
    axes.plot([at - half, at + half], [point.mean] * 2, color=colour, linewidth=2)
    if point.ci95 is not None:
        axes.plot([at] * 2, point.ci95, color=colour, linewidth=1.2)


_MOST_TRACES = 15
_BINS = 60
_GAP = 20.0
"""Times the usual step between samples: a longer one is no line."""
_TRAVELS = 0.5
"""Way in a cycle, in units of the swing about it, from which a channel travels."""
_PHASES = (np.arange(_BINS) + 0.5) / _BINS


def draw_traces(axes: Axes, view: RunView, trials: Sequence[TrialOutcome], channel: str) -> None:
    """Draw trials over each other; what the objectives leave out is shaded."""
    shown = trials[:_MOST_TRACES]
    alpha = float(np.clip(3.0 / max(len(shown), 1), 0.25, 0.8))
    end = 0.0
    for trial in shown:
        trace = view.trace(trial, channel)
        if trace is not None:
            axes.plot(*_broken(*trace), color=COLOURS[0], linewidth=0.7, alpha=alpha)
            end = max(end, trial.duration_s)
    first = shown[0]
    if first.period_s is not None and first.discard_cycles:
        axes.axvspan(0, first.discard_cycles * first.period_s, color=FAINT, alpha=0.55, linewidth=0, zorder=0)
        axes.text(
            0.5 * first.discard_cycles * first.period_s,
            0.985,
            "not counted",
            transform=axes.get_xaxis_transform(),
            ha="center",
            va="top",
            fontsize=7.5,
            color="#666666",
        )
    axes.set_xlim(0, end or 1.0)
    axes.set_xlabel("time since start of motion (s)")
    axes.set_ylabel(view.trace_label)
    zero_line(axes)


def _broken(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a trace that is interrupted where samples are missing: of some trials only some cycles are kept."""
    steps = np.diff(time_s)
    if not len(steps):
        return time_s, values
    gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    return np.insert(time_s, gaps, np.nan), np.insert(values, gaps, np.nan)


def cycles_of(view: RunView, trials: Sequence[TrialOutcome], channel: str) -> FloatArray | None:
    """Return the mean gait cycle of each trial, (trials, 60); None if the motion has no cycles, or the channel travels.

    A position that goes on from cycle to cycle has no mean cycle: its way over time says all there is.
    """
    folded = [cycle for trial in trials if (cycle := folded_cycle(view, trial, channel)) is not None]
    if not folded or any(_travels(view, trial, channel) for trial in trials):
        return None
    return np.vstack(folded)


def _travels(view: RunView, trial: TrialOutcome, channel: str) -> bool:
    """Tell whether a channel mainly grows from cycle to cycle."""
    trace = view.trace(trial, channel)
    if trace is None or trial.period_s is None:
        return False
    time_s, values = trace
    counted = time_s >= trial.discard_cycles * trial.period_s
    time_s, values = time_s[counted], values[counted]
    cycles = int((time_s[-1] - time_s[0]) / trial.period_s * (1.0 + 1e-6)) if len(time_s) > 1 else 0
    if not cycles:
        return False
    after_s = time_s[0] + cycles * trial.period_s
    way = float(np.interp(after_s, time_s, values) - values[0]) / cycles
    swing = np.ptp(values - way * (time_s - time_s[0]) / trial.period_s)
    return abs(way) > _TRAVELS * float(swing)


def draw_cycle(axes: Axes, cycles: FloatArray) -> None:
    """Draw the mean gait cycle of trials (trials, 60), with the spread between them."""
    mean = cycles.mean(axis=0)
    if len(cycles) > 1:
        spread = cycles.std(axis=0, ddof=1)
        axes.fill_between(_PHASES, mean - spread, mean + spread, color=COLOURS[0], alpha=0.22, linewidth=0)
    axes.plot(_PHASES, mean, color=COLOURS[0])
    level = float(mean.mean())
    axes.axhline(level, color=COLOURS[1], linewidth=1.1, linestyle=(0, (4, 2)))
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
    look: Any = {"ha": "right", "va": "bottom", "fontsize": 8, "color": COLOURS[1], "bbox": paper}
    annotate_point(axes, f"mean {level:.3g}", (1.0, level), (-2, 3), **look)
    axes.set_xlim(0, 1)
    axes.set_xlabel("phase of the gait cycle")
    axes.tick_params(labelleft=True)
    zero_line(axes)


def folded_cycle(view: RunView, trial: TrialOutcome, channel: str) -> FloatArray | None:
    """Return the mean cycle of a trial, in bins of the phase, shape (60,); None without cycles or samples.

    Bins that no sample falls into (a sensor slower than the gait's bins) are interpolated around the cycle.
    """
    trace = view.trace(trial, channel)
    if trace is None or trial.period_s is None:
        return None
    time_s, values = trace
    counted = time_s >= trial.discard_cycles * trial.period_s
    if np.count_nonzero(counted) < 4:
        return None
    phase = np.mod(time_s[counted] / trial.period_s, 1.0)
    # No finer than the sensor: bins of a sample or two would show noise as if it belonged to the gait.
    a_cycle = trial.period_s / float(np.median(np.diff(time_s[counted])))
    number = int(np.clip(a_cycle / 1.5, 6, _BINS))
    bins = np.minimum((phase * number).astype(int), number - 1)
    counts = np.bincount(bins, minlength=number)
    sums = np.bincount(bins, weights=values[counted], minlength=number)
    filled = np.flatnonzero(counts)
    means = sums[filled] / counts[filled]
    return np.asarray(np.interp(_PHASES, (filled + 0.5) / number, means, period=1.0))
