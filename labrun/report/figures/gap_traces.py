"""Figures of a diagnosis over time: outputs where they differ most, and the force that is missing."""

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrun.arrays import FloatArray
from labrun.experiment import condition_key
from labrun.gap import ComparedTrace, Diagnosis, MissingForce
from labrun.report.figures.gap import AFTER, RECALIBRATED, STATED
from labrun.report.statistics import root_mean_square, scaled_to_largest
from labrun.report.style import COLOURS, FAINT, INK, new_figure, zero_line
from labrun.report.text import listed, spaced, with_unit

_MOST_UNITS = 4
_MOST_OUTPUTS = 3
_MOST_SAMPLES = 700
_LINE_SAMPLES = 3
"""A trace shorter than this is a point: a reading of a static relation, not a course in time."""
_NARROW = 30


def traces_figure(diagnosis: Diagnosis) -> Figure | None:
    """Return the picture of measured and simulated outputs; None where there are none."""
    traces = shown_traces(diagnosis)
    if not traces:
        return None
    points = all(len(trace.time_s) < _LINE_SAMPLES for trace in traces)
    return _points_figure(diagnosis, traces) if points else _courses_figure(diagnosis, traces)


def shown_traces(diagnosis: Diagnosis) -> list[ComparedTrace]:
    """Return the traces that are drawn."""
    traces = [trace for trace in diagnosis.traces if trace.measured.size]
    if all(len(trace.time_s) < _LINE_SAMPLES for trace in traces):
        return sorted(traces, key=_order)
    return _various([trace for trace in traces if len(trace.time_s) >= _LINE_SAMPLES])


def _various(traces: Sequence[ComparedTrace]) -> list[ComparedTrace]:
    """Return a few traces, of as many different conditions as there are."""
    first: dict[object, ComparedTrace] = {}
    for trace in traces:
        first.setdefault(condition_key(trace.condition), trace)
    chosen = list(first.values())
    again = [trace for trace in traces if not any(trace is other for other in chosen)]
    return [*chosen, *again][:_MOST_UNITS]


def _order(trace: ComparedTrace) -> tuple[tuple[float, str], ...]:
    """Return what readings are sorted by: their condition."""
    values = trace.condition.values()
    return tuple((0.0, value) if isinstance(value, str) else (value, "") for value in values)


def _courses_figure(diagnosis: Diagnosis, traces: Sequence[ComparedTrace]) -> Figure:
    outputs = worst_outputs(diagnosis, traces)
    with new_figure(9.4, 0.75 + 2.6 * len(outputs)) as figure:
        grid = figure.subplots(
            2 * len(outputs),
            len(traces),
            squeeze=False,
            sharey="row",
            height_ratios=[1.5, 1.0] * len(outputs),
        )
        for column, trace in enumerate(traces):
            shown = _window(diagnosis, trace, outputs)
            for number, output in enumerate(outputs):
                above, below = grid[2 * number][column], grid[2 * number + 1][column]
                _draw_course(above, diagnosis, trace, output, shown)
                _draw_rest(below, diagnosis, trace, output, shown)
                if column == 0:
                    name, unit = diagnosis.channels[output]
                    above.set_ylabel(_label(name, unit))
                    below.set_ylabel(_label("difference", unit))
            grid[0][column].set_title(_title(trace, len(traces)), fontsize=8.5)
            grid[-1][column].set_xlabel("time (s)")
        figure.align_ylabels()
        _legend(figure, grid[0][0])
    return figure


def _window(diagnosis: Diagnosis, trace: ComparedTrace, outputs: Sequence[int]) -> slice:
    """Return the samples to be shown large: by the output that is farthest off."""
    rest = trace.measured - trace.recalibrated
    sd = _sd(diagnosis, rest.shape[1])
    worst = max(outputs, key=lambda output: _log_ratio(root_mean_square(rest[:, output]), float(sd[output])))
    return telling_window(trace.time_s, trace.recalibrated[:, worst], rest[:, worst])


def _sd(diagnosis: Diagnosis, outputs: int) -> FloatArray:
    return np.array([diagnosis.noise.get(name) or 1.0 for name, _ in diagnosis.channels[:outputs]])


def _log_ratio(error: float, sd: float) -> float:
    """Return the logarithm of error / sd, where the ratio itself may exceed the floating-point range."""
    return math.log(error) - math.log(sd) if error > 0.0 else -math.inf


def _draw_course(axes: Axes, diagnosis: Diagnosis, trace: ComparedTrace, output: int, shown: slice) -> None:
    kept = _thinned(shown)
    time_s = trace.time_s[kept]
    lines: list[tuple[str, FloatArray, dict[str, Any]]] = [
        ("model as stated", trace.raw, {"color": STATED, "linewidth": 1.2, "linestyle": (0, (1, 1.2))}),
        ("recalibrated", trace.recalibrated, {"color": RECALIBRATED, "linewidth": 2.4, "alpha": 0.8}),
    ]
    if diagnosis.causes:
        lines.append((_with(diagnosis), trace.after, {"color": AFTER, "linewidth": 2.4, "alpha": 0.8}))
    # thin and on top: where a model is right, it shows as a rim of its colour
    lines.append(("measured", trace.measured, {"color": INK, "linewidth": 0.8}))
    for label, values, look in lines:
        axes.plot(time_s, values[kept, output], label=label, **look)
    axes.margins(x=0.0)


def _draw_rest(axes: Axes, diagnosis: Diagnosis, trace: ComparedTrace, output: int, shown: slice) -> None:
    kept = _thinned(slice(0, len(trace.time_s)))
    time_s, measured = trace.time_s[kept], trace.measured[kept, output]
    sd = diagnosis.noise.get(diagnosis.channels[output][0])
    if sd is not None:
        axes.axhspan(
            -2 * sd, 2 * sd, color=FAINT, alpha=0.7, linewidth=0, zorder=0, label="\u00b1 2 sd of one trial"
        )
    axes.plot(time_s, measured - trace.recalibrated[kept, output], color=RECALIBRATED, linewidth=1.0)
    if diagnosis.causes:
        axes.plot(time_s, measured - trace.after[kept, output], color=AFTER, linewidth=1.0)
    zero_line(axes)
    if shown.stop - shown.start < len(trace.time_s):
        for edge in (shown.start, shown.stop - 1):
            axes.axvline(float(trace.time_s[edge]), color=INK, linewidth=0.7, linestyle=(0, (3, 2)))
    axes.margins(x=0.0)


def _points_figure(diagnosis: Diagnosis, traces: Sequence[ComparedTrace]) -> Figure:
    """Plot readings without a time axis, side by side."""
    outputs = worst_outputs(diagnosis, traces)
    places = np.arange(len(traces), dtype=float)
    with new_figure(9.4, 1.1 + 2.0 * len(outputs)) as figure:
        grid = figure.subplots(len(outputs), 1, squeeze=False, sharex=True)
        for row, output in enumerate(outputs):
            axes = grid[row][0]
            models = [
                ("model as stated", "raw", STATED, "s"),
                ("recalibrated", "recalibrated", RECALIBRATED, "D"),
            ]
            if diagnosis.causes:
                models.append((_with(diagnosis), "after", AFTER, "o"))
            name, unit = diagnosis.channels[output]
            sd = diagnosis.noise.get(name, 0.0)
            axes.errorbar(
                places,
                [float(np.mean(trace.measured[:, output])) for trace in traces],
                yerr=2 * sd,
                color=INK,
                fmt="_",
                markersize=14,
                capsize=3,
                label="measured \u00b1 2 sd of one trial",
            )
            for number, (label, attribute, colour, marker) in enumerate(models):
                values = [float(np.mean(getattr(trace, attribute)[:, output])) for trace in traces]
                shift = 0.14 * (number - 0.5 * (len(models) - 1))
                axes.plot(places + shift, values, marker, color=colour, markersize=5.5, label=label)
            axes.set_ylabel(_label(name, unit))
            axes.set_xlim(-0.6, len(traces) - 0.4)
            zero_line(axes)
        titles = [_title(trace, len(traces)) for trace in traces]
        grid[-1][0].set_xticks(places, titles, fontsize=8)
        grid[-1][0].set_xlabel("condition")
        _legend(figure, grid[0][0])
    return figure


def worst_outputs(diagnosis: Diagnosis, traces: Sequence[ComparedTrace]) -> list[int]:
    """Return the outputs that are farthest off after recalibration, in units of noise, in the model's order."""
    known = min(len(diagnosis.channels), *(trace.measured.shape[1] for trace in traces))
    sd = _sd(diagnosis, known)

    def off(output: int) -> float:
        rest = np.concatenate([trace.measured[:, output] - trace.recalibrated[:, output] for trace in traces])
        return _log_ratio(root_mean_square(rest), sd[output])

    return sorted(sorted(range(known), key=off, reverse=True)[:_MOST_OUTPUTS])


def _legend(figure: Any, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))


def _with(diagnosis: Diagnosis) -> str:
    names = listed([cause.name.words for cause in diagnosis.causes])
    return f"with {names}" if len(names) <= 2 * _NARROW else "with all causes"


def _title(trace: ComparedTrace, panels_beside: int) -> str:
    width = max(90 // panels_beside, 12)
    times = f" ({trace.repeats} repeats)" if trace.repeats > 1 else ""
    return "\n".join(textwrap.wrap(trace.label + times, width, max_lines=3, placeholder=" \u2026"))


def _label(name: str, unit: str) -> str:
    shown = spaced(name)
    if len(shown) > _NARROW:
        shown = f"{shown[: _NARROW - 1]}\u2026"
    return with_unit(shown, unit)


def _thinned(shown: slice) -> slice:
    return slice(shown.start, shown.stop, max(1, (shown.stop - shown.start) // _MOST_SAMPLES))


_CYCLES = 3.0
_WHOLE = 0.6
"""A window that is longer than this part of the trace is the trace."""


def telling_window(time_s: FloatArray, simulated: FloatArray, difference: FloatArray) -> slice:
    """Return the samples of the window; all of them where the trace has few cycles.

    Parameters
    ----------
    time_s : (n,)
    simulated : (n,)
        A signal whose crossings of its mean tell how long a cycle is; of a model, since noise crosses at random.
    difference : (n,)
        What has its largest mean square in the window.
    """
    count = len(time_s)
    crossings = int(np.count_nonzero(np.diff(simulated > simulated.mean())))
    length = int(np.ceil(2.0 * _CYCLES * count / crossings)) if crossings else count
    if length > _WHOLE * count or length < 2:
        return slice(0, count)
    sums = np.concatenate([[0.0], np.cumsum(np.square(scaled_to_largest(difference)))])
    start = int(np.argmax(sums[length:] - sums[:-length]))
    return slice(start, start + length)


_MOST_POINTS = 4000
_BINS = 25
_FEWEST_IN_BIN = 5
_KEPT = (0.5, 99.5)
"""Percentiles between which the force is drawn: an estimate runs wild at the ends of a trial."""


def force_figure(missing: MissingForce) -> Figure | None:
    """Return the picture of a missing force; None where there is nothing to draw."""
    shown = _drawable(missing)
    if not shown:
        return None
    with new_figure(9.4, 2.75) as figure:
        grid = figure.subplots(1, len(shown), squeeze=False, sharey=True)[0]
        for axes, (label, values) in zip(grid, shown.items(), strict=True):
            _scatter(axes, label, values, missing)
        grid[0].set_ylabel(with_unit(f"missing at {missing.site}", missing.unit))
    return figure


def _drawable(missing: MissingForce) -> dict[str, tuple[FloatArray, ...]]:
    """Return what the force is drawn over, by its label."""
    site, unit = missing.site, missing.coordinate_unit
    every = {
        with_unit(f"position of {site}", unit): missing.coordinate,
        with_unit(f"speed of {site}", f"{unit}/s" if unit else ""): missing.rate,
        with_unit(f"load on {site}", missing.load_unit): missing.load,
        "time (s)": missing.time_s,
    }
    return {label: values for label, values in every.items() if _matches(values, missing.force)}


def _matches(values: tuple[FloatArray, ...], force: tuple[FloatArray, ...]) -> bool:
    """Tell whether there is something to draw over: as many numbers as the force has, and not all the same."""
    if not values or [len(value) for value in values] != [len(samples) for samples in force]:
        return False
    every = np.concatenate(values)
    return every.size > 1 and bool(np.ptp(every) > 0)


def _scatter(axes: Axes, label: str, values: tuple[FloatArray, ...], missing: MissingForce) -> None:
    total = sum(len(samples) for samples in missing.force)
    step = max(1, total // _MOST_POINTS)
    for x, y in zip(values, missing.force, strict=True):
        axes.plot(x[::step], y[::step], ".", color=COLOURS[4], markersize=2.5, alpha=0.5, markeredgewidth=0)
    if not label.startswith("time"):
        middle, mean = _binned(np.concatenate(values), np.concatenate(missing.force))
        if len(middle) > 1:
            axes.plot(middle, mean, color=INK, linewidth=1.6)
    axes.set_ylim(*_span(np.concatenate(missing.force)))
    axes.locator_params(axis="x", nbins=4)
    axes.ticklabel_format(scilimits=(-3, 4))
    axes.set_xlabel(label)
    zero_line(axes)


def _binned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean of y over x, in bins that hold enough of it."""
    edges = np.linspace(float(x.min()), float(x.max()), _BINS + 1)
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
    filled = [n for n in range(_BINS) if np.count_nonzero(which == n) >= _FEWEST_IN_BIN]
    middle = np.array([0.5 * (edges[n] + edges[n + 1]) for n in filled])
    return middle, np.array([float(np.mean(y[which == n])) for n in filled])


def _span(force: FloatArray) -> tuple[float, float]:
    low, high = (float(end) for end in np.percentile(force, _KEPT))
    room = 0.1 * (high - low) or max(0.1 * abs(high), 1e-12)
    return low - room, high + room
