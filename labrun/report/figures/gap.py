"""Figures of a diagnosis: where the gap is, how far it closes, and both under the verdict."""

import math
import textwrap
from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrun.gap import By, Diagnosis, Place
from labrun.report.gap_words import (
    PlacesPanel,
    beyond_chance,
    data_words,
    never_seen,
    panels,
    place_words,
    times_noise,
)
from labrun.report.style import COLOURS, INK, annotate_point, heading, new_figure, plain_numbers
from labrun.report.text import p_words, percent

_HOW_FAR_IN = 2.2
_HEADING_IN = 0.95
_MOST_PANELS = 4


def diagnosis_figure(diagnosis: Diagnosis) -> Figure:
    """Draw where the gap is and how far it closes, under the verdict."""
    shown = panels(diagnosis.where, _MOST_PANELS)
    where_in = height_in(shown) if shown else 0.0
    with new_figure(WIDTH_IN, where_in + _HOW_FAR_IN + _HEADING_IN) as figure:
        heading(figure, f"{diagnosis.name} against the model {diagnosis.model}", _subtitle(diagnosis))
        if shown:
            parts: Any = figure.subfigures(2, 1, height_ratios=[where_in, _HOW_FAR_IN])
            draw_where(parts[0], shown)
            draw_how_far(parts[1].subplots(), diagnosis)
        else:
            draw_how_far(figure.subplots(), diagnosis)
    return figure


def _subtitle(diagnosis: Diagnosis) -> str:
    return f"{diagnosis.sentence.rstrip()} From {data_words(diagnosis)}."


TITLES: dict[By, str] = {
    "channel": "which output",
    "condition": "which condition",
    "phase": "which phase of the motion",
    "frequency": "which frequencies",
    "state": "which positions and speeds",
    "reversal": "around reversals of the motion",
}
BEYOND_CHANCE, MAYBE_CHANCE, NOT_TESTED = COLOURS[0], "#c3c7cd", COLOURS[4]
_ACROSS = 2
_BAR_IN = 0.31
_PANEL_IN = 0.62
_LABEL_CHARACTERS = 30
WIDTH_IN = 9.4


def where_figure(diagnosis: Diagnosis) -> Figure | None:
    """Return the picture of where the gap is; None where the data are not divided into parts."""
    shown = panels(diagnosis.where)
    if not shown:
        return None
    with new_figure(WIDTH_IN, height_in(shown)) as figure:
        draw_where(figure, shown)
    return figure


def height_in(shown: Sequence[PlacesPanel]) -> float:
    """Return how high the panels are together."""
    return sum(_heights(shown))


def draw_where(figure: Any, shown: Sequence[PlacesPanel]) -> None:
    """Draw the panels, two side by side, into a figure or a part of one."""
    rows = -(-len(shown) // _ACROSS)
    across = min(len(shown), _ACROSS)
    grid = figure.subplots(rows, across, squeeze=False, height_ratios=_heights(shown))
    for number in range(rows * across):
        axes = grid[number // across][number % across]
        if number >= len(shown):
            axes.set_visible(False)
            continue
        row = shown[number // across * across : (number // across + 1) * across]
        _draw(axes, shown[number], max(len(panel.places) for panel in row))
        if number + across >= len(shown):
            axes.set_xlabel("share of the excess over the noise")


def _heights(shown: Sequence[PlacesPanel]) -> list[float]:
    return [
        _PANEL_IN + _BAR_IN * max(len(panel.places) for panel in shown[start : start + _ACROSS])
        for start in range(0, len(shown), _ACROSS)
    ]


def _draw(axes: Axes, panel: PlacesPanel, slots: int) -> None:
    labels = [_label(place_words(location)) for location in panel.places]
    shares = [location.share for location in panel.places]
    colours = [_colour(location) for location in panel.places]
    notes = [_note(location) for location in panel.places]
    rows = range(len(labels))
    axes.barh(rows, shares, height=0.72, color=colours)
    for row, (share, note) in enumerate(zip(shares, notes, strict=True)):
        annotate_point(axes, note, (max(share, 0.0), row), va="center", fontsize=8)
    axes.set_yticks(rows, labels, fontsize=7.8, linespacing=1.0)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(slots - 0.4, -0.6)  # bars of one row of panels are equally thick
    axes.set_xlim(min(0.0, 1.05 * min(shares)), max(1.0, *shares) * 1.3)
    if max(shares) <= 1.0 and min(shares) > -1.0:
        axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0])
    else:
        axes.locator_params(axis="x", nbins=5)
    axes.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
    axes.axvline(0, color="#555555", linewidth=0.7)
    axes.spines["left"].set_visible(False)
    shown, every = len(panel.places), len(panel.places) + panel.others
    more = f" ({shown} of {every})" if panel.others else ""
    axes.set_title(TITLES[panel.by] + more)


def _colour(location: Place) -> str:
    if location.p is None:
        return NOT_TESTED
    return BEYOND_CHANCE if beyond_chance(location) else MAYBE_CHANCE


def _note(location: Place) -> str:
    p = p_words(location.p)
    return f"{percent(location.share)}   {p}" if p else percent(location.share)


def _label(text: str) -> str:
    lines = textwrap.wrap(text, _LABEL_CHARACTERS, break_long_words=True, max_lines=2, placeholder=" \u2026")
    return "\n".join(lines)


STATED, RECALIBRATED, AFTER = "#9aa0a8", COLOURS[5], COLOURS[0]
"""Colours of the three models, here and in the traces."""
_FLOOR = "#dfe9df"
_FLOOR_EDGE = COLOURS[2]
_WIDE_RATIO = 30.0
"""From so much between the largest and the smallest bar on, the axis is logarithmic."""
_ROOM = 1.1
_LONGEST_LABEL = 34
"""A longer label of a bar is broken between its causes."""


def how_far_figure(diagnosis: Diagnosis) -> Figure:
    """Return the picture of how far the gap closes."""
    with new_figure(9.4, 2.3) as figure:
        draw_how_far(figure.subplots(), diagnosis)
    return figure


def draw_how_far(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw the ladder: a bar for the model as stated, recalibrated, with each cause in turn, over the noise floor."""
    gap, colours = diagnosis.gap, (STATED, RECALIBRATED)
    rows = [
        (_wrapped(rung.step), rung.in_noise, colours[index] if index < len(colours) else AFTER)
        for index, rung in enumerate(diagnosis.ladder)
    ]
    sizes = [max(size, 0.0) if math.isfinite(size) else 0.0 for _, size, _ in rows]
    largest = max(*sizes, gap.floor) or 1.0
    low = _set_scale(axes, [*sizes, gap.floor], largest)
    floor = max(gap.floor, low)  # of next to nothing: at the end of a logarithmic axis, not far beyond it
    axes.axvspan(low, floor, color=_FLOOR, linewidth=0, zorder=0)
    axes.axvline(floor, color=_FLOOR_EDGE, linewidth=1.2, linestyle=(0, (4, 2)), zorder=3)
    for row, ((_, size, colour), width) in enumerate(zip(rows, sizes, strict=True)):
        axes.barh(row, max(width - low, 0.0), left=low, height=0.62, color=colour, zorder=2)
        annotate_point(
            axes,
            times_noise(size),
            (_clear_of(axes, max(width, low), floor), row),
            (5, 0),
            va="center",
            fontsize=9.5,
            fontweight="bold" if row == len(rows) - 1 else "normal",
            zorder=4,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
        )
    axes.set_title(_removed(diagnosis))
    axes.set_yticks(range(len(rows)), [label for label, _, _ in rows], fontsize=9)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(rows) - 0.45, -0.95)
    if gap.floor > 0.0:
        axes.text(
            floor,
            -0.56,
            f" noise floor {times_noise(gap.floor)}",
            color="#00694c",
            fontsize=8.5,
            va="bottom",
            ha="left" if _place(axes, floor) < 0.8 else "right",
        )
    axes.set_xlabel(
        "error on unseen data: rms of measured - simulated beyond the noise (noise of one trial = 1)"
        + (", logarithmic" if axes.get_xscale() == "log" else ""),
        color=INK,
    )


def _set_scale(axes: Axes, sizes: list[float], largest: float) -> float:
    """Set the axis, logarithmic where the smallest bar would vanish; return where it begins."""
    visible = [size for size in sizes if size > 1e-6 * largest]
    if visible and largest / min(visible) > _WIDE_RATIO:
        axes.set_xscale("log")
        low = 0.5 * min(visible)
        axes.set_xlim(low, largest * (largest / low) ** (_ROOM - 1))
        plain_numbers(axes.xaxis)
        return low
    axes.set_xlim(0.0, largest * _ROOM)
    return 0.0


def _place(axes: Axes, value: float) -> float:
    """Return where along the axis a value stands, from 0 to 1."""
    return float((axes.transScale + axes.transLimits).transform((max(value, 1e-300), 0.0))[0])


def _clear_of(axes: Axes, width: float, floor: float) -> float:
    """Return where a bar's number begins: at its end, or behind the floor's line where that would cross it."""
    return floor if -0.12 < _place(axes, width) - _place(axes, floor) < 0 else width


def _wrapped(step: str) -> str:
    """Return the label of a ladder step, wrapped to fit beside the bars."""
    return step if len(step) <= _LONGEST_LABEL else step.replace(" at ", "\nat ")


def _removed(diagnosis: Diagnosis) -> str:
    share = diagnosis.shrinkage
    if share is None or not diagnosis.causes:
        return "how far the gap closes"
    value, low, high = map(percent, share.of_gap)
    return f"how far the gap closes: {value} (90 % interval {low} to {high}), {never_seen(diagnosis)}"
