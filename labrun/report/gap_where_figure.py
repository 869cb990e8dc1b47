"""Where model and measurement differ: shares of the excess by channel, condition, phase and so on, as bars."""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from labrun.gap.diagnosis import By, Diagnosis, Place
from labrun.report.gap_canvas import plain_figure
from labrun.report.gap_places import Panel, beyond_chance, panels, place_words
from labrun.report.style import COLOURS
from labrun.report.svg import as_svg
from labrun.report.text import p_words, percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TITLES: dict[By, str] = {
    "channel": "which output",
    "condition": "which condition",
    "phase": "which phase of the motion",
    "frequency": "which frequencies",
    "state": "which positions and speeds",
    "reversal": "around reversals of the motion",
    "equation": "which equation lacks a force",
}
BEYOND_CHANCE, MAYBE_CHANCE, NOT_TESTED = COLOURS[0], "#c3c7cd", COLOURS[4]
_ACROSS = 2
_BAR_IN = 0.31
_PANEL_IN = 0.62
_LABEL_CHARACTERS = 30
WIDTH_IN = 9.4


def where_svg(diagnosis: Diagnosis) -> bytes | None:
    """Return the picture of where the gap is; None where the data are not divided into parts."""
    shown = panels(diagnosis.where)
    if not shown:
        return None
    with plain_figure(WIDTH_IN, height_in(shown)) as figure:
        draw_where(figure, shown)
        return as_svg(figure)


def height_in(shown: Sequence[Panel]) -> float:
    """Return how high the panels are together."""
    return sum(_heights(shown))


def draw_where(figure: Any, shown: Sequence[Panel]) -> None:
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


def _heights(shown: Sequence[Panel]) -> list[float]:
    return [
        _PANEL_IN + _BAR_IN * max(len(panel.places) for panel in shown[start : start + _ACROSS])
        for start in range(0, len(shown), _ACROSS)
    ]


def _draw(axes: "Axes", panel: Panel, slots: int) -> None:
    labels = [_label(place_words(place)) for place in panel.places]
    shares = [place.share for place in panel.places]
    colours = [_colour(place) for place in panel.places]
    notes = [_note(place) for place in panel.places]
    rows = range(len(labels))
    axes.barh(rows, shares, height=0.72, color=colours)
    for row, (share, note) in enumerate(zip(shares, notes, strict=True)):
        axes.annotate(
            note, (max(share, 0.0), row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8
        )
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


def _colour(place: Place) -> str:
    if place.p is None:
        return NOT_TESTED
    return BEYOND_CHANCE if beyond_chance(place) else MAYBE_CHANCE


def _note(place: Place) -> str:
    p = p_words(place.p)
    return f"{percent(place.share)}   {p}" if p else percent(place.share)


def _label(text: str) -> str:
    lines = textwrap.wrap(text, _LABEL_CHARACTERS, break_long_words=True, max_lines=2, placeholder=" \u2026")
    return "\n".join(lines)
