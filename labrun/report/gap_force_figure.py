"""The force a model lacks, against what it may depend on: coordinate, rate, load and time."""

from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labrun.gap.diagnosis import MissingForce
from labrun.report.gap_canvas import plain_figure
from labrun.report.style import COLOURS, DPI, INK, zero_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FloatArray = NDArray[np.float64]

_MOST_POINTS = 4000
_BINS = 25
_FEWEST_IN_BIN = 5
_KEPT = (0.5, 99.5)
"""Percentiles between which the force is drawn: an estimate runs wild at the ends of a trial."""


@dataclass(frozen=True, slots=True)
class _Against:
    """What the force is drawn over."""

    label: str
    values: tuple[FloatArray, ...]


def force_png(missing: MissingForce) -> bytes | None:
    """Return the picture of a missing force; None where there is nothing to draw."""
    shown = _drawable(missing)
    if not shown:
        return None
    with plain_figure(9.4, 2.75) as figure:
        grid = figure.subplots(1, len(shown), squeeze=False, sharey=True)[0]
        for axes, against in zip(grid, shown, strict=True):
            _scatter(axes, against, missing)
        grid[0].set_ylabel(_with_unit(f"missing at {missing.site}", missing.unit))
        buffer = BytesIO()
        figure.savefig(buffer, dpi=DPI, format="png", metadata={"Software": None})
        return buffer.getvalue()


def _drawable(missing: MissingForce) -> list[_Against]:
    coordinate = missing.coordinate_unit
    every = [
        _Against(_with_unit(f"position of {missing.site}", coordinate), missing.coordinate),
        _Against(
            _with_unit(f"speed of {missing.site}", f"{coordinate}/s" if coordinate else ""), missing.rate
        ),
        _Against(_with_unit(f"load on {missing.site}", missing.load_unit), missing.load),
        _Against("time (s)", missing.time_s),
    ]
    return [one for one in every if _matches(one.values, missing.force)]


def _matches(values: tuple[FloatArray, ...], force: tuple[FloatArray, ...]) -> bool:
    """Tell whether there is something to draw over: as many numbers as the force has, and not all the same."""
    if not values or [len(one) for one in values] != [len(one) for one in force]:
        return False
    every = np.concatenate(values)
    return every.size > 1 and bool(np.ptp(every) > 0)


def _scatter(axes: "Axes", against: _Against, missing: MissingForce) -> None:
    total = sum(len(one) for one in missing.force)
    step = max(1, total // _MOST_POINTS)
    for x, y in zip(against.values, missing.force, strict=True):
        axes.plot(x[::step], y[::step], ".", color=COLOURS[4], markersize=2.5, alpha=0.5, markeredgewidth=0)
    if not against.label.startswith("time"):
        middle, mean = _binned(np.concatenate(against.values), np.concatenate(missing.force))
        if len(middle) > 1:
            axes.plot(middle, mean, color=INK, linewidth=1.6)
    axes.set_ylim(*_span(np.concatenate(missing.force)))
    axes.locator_params(axis="x", nbins=4)
    axes.ticklabel_format(scilimits=(-3, 4))
    axes.set_xlabel(against.label)
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


def _with_unit(text: str, unit: str) -> str:
    return text if unit in ("1", "") else f"{text} ({unit})"
