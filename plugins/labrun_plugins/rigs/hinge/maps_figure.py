"""Measured k and b of every specimen, the fitted maps and the published ones, and what is left."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from labrun.devices import FloatArray
from labrun_plugins.rigs.hinge.polynomial import FittedMap
from labrun_plugins.rigs.hinge.published import PUBLISHED_RANGE
from labrun_plugins.rigs.hinge.specimens import SIZES, Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MEASURED, _SIMULATED, _LEFT, _INK, _GRID = "#9aa5b1", "#c2410c", "#1d4e89", "#1f2933", "#e4e7eb"
_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans", "font.size": 8.5, "axes.edgecolor": "#7b8794", "axes.linewidth": 0.6,
    "axes.labelcolor": _INK, "text.color": _INK, "xtick.color": "#52606d", "ytick.color": "#52606d",
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 2.5, "ytick.major.size": 2.5,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": _GRID, "grid.linewidth": 0.6,
    "axes.axisbelow": True, "legend.frameon": False, "figure.facecolor": "white", "axes.titlesize": 8.5,
}  # fmt: skip
_AXES = {"a": "body's area a, cm\N{SUPERSCRIPT TWO}", "l": "hinge length l, mm", "w": "hinge width w, mm"}
_CELL = (4.1, 3.5)
_HEADING = 0.55
_ALIKE = 1e-6
_SCALES: dict[str, tuple[float, str]] = {
    "damping": (1e6, "\N{GREEK SMALL LETTER MU}N m s/rad"), "stiffness": (1e3, "mN m/rad"),
}  # fmt: skip


def draw_maps(maps: Sequence[FittedMap], specimens: Sequence[Specimen], way: str) -> "Figure":
    """Return the figure: a row for each quantity, a column for each size that differs between specimens.

    A panel shows the specimens on one line: those that differ from the one where the lines cross in that size only.
    Below it stands how far each specimen lies off the fitted map, with the interval of its releases.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = [name for name in ("w", "l", "a") if any(name in one.form.variables for one in maps)]
    height = _CELL[1] * len(maps) + _HEADING
    with rc_context(cast("Any", _STYLE)):
        figure = Figure(figsize=(max(_CELL[0] * len(names), 5.5), height), dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        ratios = [part for _ in maps for part in (2.4, 1.0)]
        grid = figure.add_gridspec(2 * len(maps), len(names), height_ratios=ratios)
        for row, one in enumerate(maps):
            shown = [name for name in names if name in one.form.variables]
            for column, name in enumerate(shown):
                upper = figure.add_subplot(grid[2 * row, column])
                lower = figure.add_subplot(grid[2 * row + 1, column], sharex=upper)
                _panel(upper, lower, one, name, specimens, way, first=column == 0)
                if row == 0 and column == 0:
                    upper.legend(loc="best", fontsize=7.5, handlelength=1.8)
        figure.suptitle(
            "Hinges over their sizes: " + ", ".join(_told(one) for one in maps),
            x=0.01,
            ha="left",
            fontsize=10,
        )
    return figure


def _told(one: FittedMap) -> str:
    return f"{one.form.label} MAE {one.percent(one.mae):.2g} %"


def _panel(
    upper: "Axes",
    lower: "Axes",
    one: FittedMap,
    name: str,
    specimens: Sequence[Specimen],
    way: str,
    *,
    first: bool,
) -> None:
    scale, unit = _SCALES[one.form.quantity]
    size = 1.0 / SIZES[name][1]
    points = one.line(name)
    x = size * points[name]
    low, high = one.band(points)
    upper.fill_between(x, scale * low, scale * high, color=_SIMULATED, alpha=0.15, linewidth=0)
    upper.plot(x, scale * one.value(points), color=_SIMULATED, linewidth=1.2, label="fitted map, 95 % band")
    published = _published(one, name, points, specimens)
    if np.isfinite(published).any() and one.form.published is not None:
        label = f"published map {one.form.published.equation}"
        upper.plot(x, scale * published, color=_LEFT, linewidth=1.0, linestyle=(0, (5, 3)), label=label)
    on_line = np.array([_on_line(one, name, place) for place in range(len(specimens))])
    at = size * one.sizes[name][on_line]
    measured, fitted = one.measured[on_line], one.fitted[on_line]
    ends = np.array([specimen.by(way)[1][one.form.quantity].ci95 for specimen in specimens])[on_line]
    # a resampled interval may lie to one side of its mean only by rounding
    bars = np.maximum(np.column_stack([measured - ends[:, 0], ends[:, 1] - measured]).T, 0.0)
    style: dict[str, Any] = {
        "linestyle": "none",
        "marker": "o",
        "markersize": 4,
        "capsize": 2.5,
        "elinewidth": 0.9,
    }
    upper.errorbar(at, scale * measured, scale * bars, color=_INK, label="measured, 95 % (releases)", **style)
    values = scale * np.concatenate([ends.ravel(), one.value(points), published[np.isfinite(published)]])
    room = 0.12 * float(np.ptp(values))
    floor, top = float(values.min()) - room, float(values.max()) + room
    upper.set_ylim(min(floor, 0.0) if floor < 0 else floor, top)
    if floor < 0:
        upper.axhline(0.0, color=_MEASURED, linewidth=0.8)
    percent = 100.0 / fitted
    lower.axhline(0.0, color=_MEASURED, linewidth=0.6)
    lower.errorbar(at, percent * (measured - fitted), np.abs(percent) * bars, color=_LEFT, **style)
    limit = 1.25 * max(
        float(np.max(np.abs(percent * (measured - fitted)) + np.max(np.abs(percent) * bars))), 0.1
    )
    lower.set_ylim(-limit, limit)
    upper.tick_params(labelbottom=False)
    lower.set_xlabel(_AXES[name])
    others = [
        f"{other} = {value / SIZES[other][1]:g} {_AXES[other].rpartition(', ')[2]}"
        for other, value in one.crossing.items()
        if other != name
    ]
    upper.set_title(
        f"{one.form.symbol} over {name}" + (f" at {', '.join(others)}" if others else ""),
        loc="left",
        fontweight="bold",
    )
    if first:
        upper.set_ylabel(f"{one.form.quantity} {one.form.symbol}, {unit}")
        lower.set_ylabel("off the map, %")


def _published(
    one: FittedMap, name: str, points: dict[str, FloatArray], specimens: Sequence[Specimen]
) -> FloatArray:
    """Return the published map along a line, nan where it may not be read."""
    values = np.full(len(points[name]), np.nan)
    if one.form.published is not None and any(
        np.isfinite(one.form.published_value(specimen.sizes)) for specimen in specimens
    ):
        low, high = PUBLISHED_RANGE[name]
        for place in np.flatnonzero((points[name] >= low) & (points[name] <= high)):
            values[place] = one.form.published.value({other: at[place] for other, at in points.items()})
    return values


def _on_line(one: FittedMap, name: str, place: int) -> bool:
    return all(
        abs(one.sizes[other][place] / value - 1) <= _ALIKE
        for other, value in one.crossing.items()
        if other != name
    )
