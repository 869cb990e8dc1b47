"""How far the gap closes: from the model as stated down to the noise floor, as bars."""

import math
from typing import TYPE_CHECKING

from labrun.gap.diagnosis import Diagnosis
from labrun.report.gap_canvas import plain_figure
from labrun.report.style import COLOURS, INK
from labrun.report.svg import as_svg
from labrun.report.text import listed, never_seen, percent, times_noise

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STATED, RECALIBRATED, AFTER = "#9aa0a8", COLOURS[5], COLOURS[0]
"""Colours of the three models, here and in the traces."""
_FLOOR = "#dfe9df"
_FLOOR_EDGE = COLOURS[2]
_WIDE_RATIO = 30.0
"""From so much between the largest and the smallest bar on, the axis is logarithmic."""
_ROOM = 1.1
_LONGEST_LABEL = 34
"""A longer label of a bar is broken between its causes."""


def how_far_svg(diagnosis: Diagnosis) -> bytes:
    """Return the picture of how far the gap closes."""
    with plain_figure(9.4, 2.3) as figure:
        draw_how_far(figure.subplots(), diagnosis)
        return as_svg(figure)


def draw_how_far(axes: "Axes", diagnosis: Diagnosis) -> None:
    """Draw one bar for the model as stated, recalibrated, and with its causes, over the noise floor."""
    gap = diagnosis.gap
    rows = [("model as stated", gap.raw, STATED), ("recalibrated", gap.recalibrated, RECALIBRATED)]
    if diagnosis.causes:
        rows.append((_with_causes(diagnosis), gap.after, AFTER))
    sizes = [max(size, 0.0) if math.isfinite(size) else 0.0 for _, size, _ in rows]
    largest = max(*sizes, gap.floor) or 1.0
    low = _set_scale(axes, [*sizes, gap.floor], largest)
    axes.axvspan(low, gap.floor, color=_FLOOR, linewidth=0, zorder=0)
    axes.axvline(gap.floor, color=_FLOOR_EDGE, linewidth=1.2, linestyle=(0, (4, 2)), zorder=3)
    for row, ((_, size, colour), width) in enumerate(zip(rows, sizes, strict=True)):
        axes.barh(row, max(width - low, 0.0), left=low, height=0.62, color=colour, zorder=2)
        axes.annotate(
            times_noise(size),
            (_clear_of(axes, max(width, low), gap.floor), row),
            xytext=(5, 0),
            textcoords="offset points",
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
    axes.text(
        gap.floor,
        -0.56,
        f" noise floor {times_noise(gap.floor)}",
        color="#00694c",
        fontsize=8.5,
        va="bottom",
        ha="left" if _place(axes, gap.floor) < 0.8 else "right",
    )
    axes.set_xlabel(
        f"gap: rms of measured - simulated beyond the noise (noise of one trial = 1){_scale_note(axes)}",
        color=INK,
    )


def _set_scale(axes: "Axes", sizes: list[float], largest: float) -> float:
    """Set the axis, logarithmic where the smallest bar would vanish; return where it begins."""
    visible = [size for size in sizes if size > 1e-6 * largest]
    if visible and largest / min(visible) > _WIDE_RATIO:
        axes.set_xscale("log")
        low = 0.5 * min(visible)
        axes.set_xlim(low, largest * (largest / low) ** (_ROOM - 1))
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.xaxis.set_minor_formatter(lambda *_: "")
        return low
    axes.set_xlim(0.0, largest * _ROOM)
    return 0.0


def _place(axes: "Axes", value: float) -> float:
    """Return where along the axis a value stands, from 0 to 1."""
    low, high = axes.get_xlim()
    if axes.get_xscale() == "log":
        return math.log(max(value, low) / low) / math.log(high / low)
    return (value - low) / (high - low)


def _clear_of(axes: "Axes", width: float, floor: float) -> float:
    """Return where a bar's number begins: at its end, or behind the floor's line where that would cross it."""
    return floor if -0.12 < _place(axes, width) - _place(axes, floor) < 0 else width


def _scale_note(axes: "Axes") -> str:
    return ", logarithmic" if axes.get_xscale() == "log" else ""


def _with_causes(diagnosis: Diagnosis) -> str:
    names = listed([cause.name.words for cause in diagnosis.causes])
    label = f"with {names}"
    if len(label) <= _LONGEST_LABEL:
        return label
    return f"with {names.replace(' and ', chr(10) + 'and ').replace(', ', ',' + chr(10))}"


def _removed(diagnosis: Diagnosis) -> str:
    share = diagnosis.shrinkage
    if share is None or not diagnosis.causes:
        return "how far the gap closes"
    ends = f"90 % interval {percent(share.low)} to {percent(share.high)}"
    return f"how far the gap closes: {percent(share.value)} of its excess ({ends}), {never_seen(diagnosis)}"
