"""Figures of how far a run can be believed: drift, settling, repeatability."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrun.arrays import FloatArray
from labrun.report.data import RunView
from labrun.report.statistics import Drift, Repeatability, chance_band, line_band, reference_values, spreads
from labrun.report.style import COLOURS, SOFT, legend_above, new_figure
from labrun.report.text import slope_words, with_unit
from labrun.store import TrialOutcome

MOST_PANELS = 4


def draw_drift(view: RunView, trends: Sequence[Drift]) -> Figure:
    """Return the figure as SVG, one panel an objective, at most `MOST_PANELS`.

    `view`: the run. `found`: its drift, from `labrun.report.statistics.drift`.
    """
    shown = trends[:MOST_PANELS]
    with new_figure(7.4, 0.5 + 1.75 * len(shown)) as figure:
        rows: Any = figure.subplots(len(shown), 1, sharex=True, squeeze=False)
        for axes, item in zip(rows[:, 0], shown, strict=True):
            _panel(axes, view, item)
        rows[-1, 0].set_xlabel("bench time since the first trial (h)")
    return figure


def _panel(axes: Axes, view: RunView, item: Drift) -> None:
    hours, values = reference_values(view, item.objective)
    at = np.linspace(hours.min(), hours.max(), 60)
    line, half = line_band(hours, values, at)
    colour = COLOURS[1] if item.visible else COLOURS[0]
    axes.fill_between(at, line - half, line + half, color=colour, alpha=0.15, linewidth=0)
    axes.plot(at, line, color=colour)
    axes.plot(hours, values, "o", color=SOFT, markersize=4, markeredgewidth=0)
    axes.set_ylabel(with_unit(item.objective, item.unit))
    axes.set_title(f"slope {slope_words(item.slope_per_h, item.ci95, item.unit)}")


_MOST_BINS = 36
_COLOUR = {"quiet": COLOURS[0], "timeout": COLOURS[1], "time": COLOURS[2]}


def draw_settling(outcomes: Sequence[TrialOutcome]) -> Figure:
    """Return the figure as SVG: distribution of settle times by reason, and settle times in the order of trials."""
    waited = [
        (outcome.index, outcome.settle.duration_s, outcome.settle.reason)
        for outcome in outcomes
        if outcome.settle is not None
    ]
    times = np.array([duration_s for _, duration_s, _ in waited])
    reasons = sorted({reason for _, _, reason in waited})
    by_reason = [np.array([t for _, t, r in waited if r == reason]) for reason in reasons]
    colours = [_COLOUR.get(reason, COLOURS[3]) for reason in reasons]
    edges = _edges(float(times.max()))
    with new_figure(7.4, 2.7) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.25])
        left.hist(by_reason, bins=edges.tolist(), stacked=True, color=colours, label=reasons, linewidth=0)
        left.set_xlabel("settle time (s)")
        left.set_ylabel("trials")
        left.set_xlim(0, edges[-1])
        legend_above(left)
        small: Any = {"markersize": 2.6, "alpha": 0.6, "markeredgewidth": 0}
        for reason, colour in zip(reasons, colours, strict=True):
            part = [(index, t) for index, t, r in waited if r == reason]
            right.plot(*zip(*part, strict=True), "o", color=colour, **small)
        right.set_xlabel("trial, in the order they ran")
        right.set_ylabel("settle time (s)")
        right.set_ylim(0, edges[-1])
    return figure


def _edges(longest_s: float) -> FloatArray:
    """Return edges of bins of a round width, so that times in whole steps of the clock fill them evenly."""
    least = max(longest_s, 0.1) / _MOST_BINS
    decade = 10.0 ** math.floor(math.log10(least))
    width = next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= least)
    return width * np.arange(math.floor(longest_s / width) + 2, dtype=np.float64)


def draw_repeatability(view: RunView, item: Repeatability) -> Figure:
    """Return the figure of one objective as SVG."""
    means, sds, counts = spreads(view, item.objective)
    usual = Counter(counts.tolist()).most_common(1)[0][0]
    low, high = chance_band(item.sd, usual)
    with new_figure(7.4, 3.1) as figure:
        axes: Any = figure.subplots(1, 1)
        axes.axhspan(low, high, color=COLOURS[0], alpha=0.10, linewidth=0)
        axes.axhline(item.sd, color=COLOURS[0], label=f"pooled sd, {item.sd:.2g} {item.unit}".rstrip())
        axes.fill_between([], [], [], color=COLOURS[0], alpha=0.18, label=f"95 % of sds of {usual} by chance")
        axes.plot(
            means, sds, "o", color=SOFT, markersize=3.4, alpha=0.65, markeredgewidth=0, label="a condition"
        )
        axes.set_ylim(0, 1.08 * max(float(sds.max()), high))
        axes.set_xlabel(with_unit(f"mean of {item.objective}", item.unit))
        axes.set_ylabel(with_unit("sd of single trials", item.unit))
        legend_above(axes)
    return figure
