"""The figure of a sweep: the objective over up to three parameters, and the force at its best."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from labrun.arrays import FloatArray
from labrun.experiment import Value
from labrun.report.data import Point, RunView
from labrun.report.figures.runs import cycles_of, draw_cycle, draw_traces
from labrun.report.style import BEST, COLOURS, DIVERGING, SEQUENTIAL, SOFT, heading, new_figure, zero_line
from labrun.report.text import label, unit_text, value_text

_MOST_GRID_VALUES = 60
_MOST_TICKS = 5
"""Values of an axis that are all written; of more, round numbers between them."""


@dataclass(frozen=True)
class Axis:
    """One parameter of a sweep.

    Attributes
    ----------
    name
        Its name in the file.
    values
        Distinct values in ascending order, or words in order of appearance; of a scattered design, the
        lower edges of bins.
    is_grid
        Whether conditions sit on the values, rather than scatter between them.
    """

    name: str
    values: tuple[Value, ...]
    is_grid: bool

    @property
    def is_words(self) -> bool:
        """Tell whether the values are words."""
        return any(isinstance(value, str) for value in self.values)

    @property
    def edges(self) -> FloatArray:
        """Edges of the cells around the values: half way to the neighbours, shape (values + 1,)."""
        centres = np.array([self._number(value) for value in self.values])
        if len(centres) == 1:
            return np.array([centres[0] - 0.5, centres[0] + 0.5])
        middles = (centres[1:] + centres[:-1]) / 2
        return np.concatenate([[2 * centres[0] - middles[0]], middles, [2 * centres[-1] - middles[-1]]])

    def position(self, condition: Mapping[str, Value]) -> float:
        """Return where a condition lies on the axis."""
        return self._number(condition[self.name])

    def bin_of(self, condition: Mapping[str, Value]) -> int:
        """Return the number of the cell or panel a condition falls into."""
        value = condition[self.name]
        if self.is_words:
            return self.values.index(value) if value in self.values else -1
        numbers = np.array([self._number(item) for item in self.values])
        if self.is_grid:
            nearest = int(np.argmin(np.abs(numbers - float(value))))
            return nearest if np.isclose(numbers[nearest], float(value), rtol=1e-9, atol=1e-12) else -1
        return int(np.searchsorted(numbers, float(value), side="right")) - 1

    def name_of(self, number: int) -> str:
        """Return what follows the name in a panel's title: ``= 5``, or the range of a bin."""
        if self.is_grid:
            return f"= {value_text(self.values[number])}"
        if number + 1 >= len(self.values):
            return f"above {value_text(self.values[number])}"
        return f"{value_text(self.values[number])} to {value_text(self.values[number + 1])}"

    def thinned(self, most: int) -> "Axis":
        """Return an axis fit for panels: at most so many values evenly taken, or three bins of a scattered one."""
        if not self.is_grid:
            numbers = np.array([self._number(value) for value in self.values])
            return Axis(self.name, tuple(np.quantile(numbers, [0.0, 1 / 3, 2 / 3]).tolist()), is_grid=False)
        if len(self.values) <= most:
            return self
        chosen = np.unique(np.linspace(0, len(self.values) - 1, most).round().astype(int))
        return Axis(self.name, tuple(self.values[index] for index in chosen), is_grid=True)

    def ticks(self, axis: Any) -> None:
        """Set the ticks of a matplotlib axis."""
        if self.is_words:
            axis.set_ticks(range(len(self.values)), [str(value) for value in self.values])
        elif self.is_grid and len(self.values) <= _MOST_TICKS:
            axis.set_ticks(
                [self._number(value) for value in self.values], [value_text(value) for value in self.values]
            )
        else:
            axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))

    def _number(self, value: Value) -> float:
        return float(self.values.index(value)) if isinstance(value, str) else float(value)


def axes_of(points: Sequence[Point]) -> list[Axis]:
    """Return what varies between conditions, in the order of the file."""
    axes = []
    for name in points[0].condition if points else ():
        values = list(dict.fromkeys(point.condition[name] for point in points))
        if len(values) < 2:
            continue
        words = any(isinstance(value, str) for value in values)
        ordered = values if words else sorted(values, key=float)
        axes.append(Axis(name, tuple(ordered), is_grid=words or len(values) <= _MOST_GRID_VALUES))
    if len(axes) > 1 and all(len(axis.values) == len(points) for axis in axes):
        return [Axis(axis.name, axis.values, is_grid=axis.is_words) for axis in axes]
    return axes


def most_telling(points: Sequence[Point], axes: Sequence[Axis], count: int) -> list[Axis]:
    """Return the axes along which the mean objective varies most, in the order of the file."""

    def variation(axis: Axis) -> float:
        groups: dict[object, list[float]] = {}
        for point in points:
            key = point.condition[axis.name] if axis.is_grid else axis.thinned(3).bin_of(point.condition)
            groups.setdefault(key, []).append(point.mean)
        return float(np.std([np.mean(values) for values in groups.values()]))

    chosen = sorted(axes, key=variation, reverse=True)[:count]
    return [axis for axis in axes if axis in chosen]


def best_over_others(points: Sequence[Point], axes: Sequence[Axis], *, maximise: bool) -> list[Point]:
    """Return, for each combination on these axes, the best point over all other parameters."""
    best: dict[object, Point] = {}
    for point in points:
        key = tuple(point.condition[axis.name] for axis in axes)
        known = best.get(key)
        if known is None or (point.mean > known.mean) == maximise:
            best[key] = point
    return list(best.values())


_MOST_PANELS = 12
_COLUMNS = 4


@dataclass(frozen=True)
class _Map:
    """What all panels share."""

    view: RunView
    points: Sequence[Point]
    x: Axis
    y: Axis
    colours: str
    norm: Normalize


def draw_sweep(view: RunView) -> Figure:
    """Draw a sweep.

    One parameter gives a curve with intervals, two a map, three a map per value of the third; of more than three
    the ones that matter most are shown, each cell with the best over the others. Colours are
    centred at zero where the objective takes both signs. The star is the honest best.
    """
    objective = view.objective
    if objective is None:
        raise ValueError("a sweep without objectives has nothing to map")
    points = view.points(objective, roles=("measure",))
    axes = axes_of(points)
    if len(axes) < 2:
        return _draw_curve(view, points, axes)
    maximise = view.experiment.goal is None or view.experiment.goal[1] == "maximise"
    left_out = ""
    if len(axes) > 3:
        shown = most_telling(points, axes, 3)
        others = [axis.name for axis in axes if axis not in shown]
        points, axes = best_over_others(points, shown, maximise=maximise), shown
        left_out = f"; each cell is the best over {', '.join(others)}"
    return _draw_maps(view, points, axes, left_out)


def _draw_maps(view: RunView, points: Sequence[Point], axes: Sequence[Axis], left_out: str) -> Figure:
    panels, x, y = _arrange(axes)
    values = panels.values if panels is not None else [None]
    rows, columns = _layout(len(values))
    trials = view.best_trials
    height = 2.35 * rows + (2.5 if trials else 0.3) + 0.7
    with new_figure(max(2.55 * columns + 0.9, 8.6), height) as figure:
        parts: Any = figure.subfigures(2, 1, height_ratios=[2.35 * rows, 2.5]) if trials else [figure]
        grid = parts[0].subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        shared = _Map(view, points, x, y, *map_colours(points))
        mesh = None
        for number, panel in enumerate(grid.flat):
            if number >= len(values):
                panel.set_visible(False)
                continue
            mesh = _panel(panel, shared, panels, number) or mesh
            _edge_labels(panel, shared, number, rows, columns, len(values))
        if mesh is not None:
            bar = parts[0].colorbar(
                mesh, ax=grid, shrink=0.92, aspect=28, pad=0.015, label=view.objective_label
            )
            bar.outline.set_visible(False)
        if trials and view.channel is not None:
            cycles = cycles_of(view, trials, view.channel)
            ratios = [1.0] if cycles is None else [1.7, 1.0]
            below = parts[1].subplots(1, len(ratios), width_ratios=ratios, squeeze=False)[0]
            draw_traces(below[0], view, trials, view.channel)
            below[0].set_title(f"the best condition, {len(trials)} trials over each other")
            if cycles is not None:
                draw_cycle(below[1], cycles)
                below[1].set_title("its mean gait cycle, ± sd between trials")
        legend = "; hatched: not measured" if shared.x.is_grid and shared.y.is_grid else ""
        measured = view.points(str(view.objective), roles=("measure",))
        heading(figure, view.experiment.title, _subtitle(view, measured) + left_out + legend)
    return figure


def _subtitle(view: RunView, points: Sequence[Point]) -> str:
    count = f"{len(points)} conditions, {sum(len(point.values) for point in points)} accepted trials"
    return view.with_best(count, " (★)")


def _arrange(axes: Sequence[Axis]) -> tuple[Axis | None, Axis, Axis]:
    """Return what the panels are, and x and y in each: the axis with fewest values makes the panels."""
    if len(axes) == 2:
        x, y = sorted(axes, key=lambda axis: -len(axis.values))
        return None, x, y
    candidates = sorted(axes, key=lambda axis: (not axis.is_words, len(axis.values)))
    panels = candidates[0].thinned(_MOST_PANELS)
    x, y = sorted(candidates[1:], key=lambda axis: -len(axis.values))
    return panels, x, y


def _layout(count: int) -> tuple[int, int]:
    if count <= _COLUMNS:
        return 1, count
    columns = min((number for number in (3, 4, 5)), key=lambda number: (-count % number, abs(number - 4)))
    return -(-count // columns), columns


def _panel(panel: Axes, shared: _Map, panels: Axis | None, number: int) -> Any:
    inside = [p for p in shared.points if panels is None or panels.bin_of(p.condition) == number]
    table = np.full((len(shared.y.values), len(shared.x.values)), np.nan)
    for point in inside:
        table[shared.y.bin_of(point.condition), shared.x.bin_of(point.condition)] = point.mean
    mesh: Any = None
    if shared.x.is_grid and shared.y.is_grid:
        panel.patch.set(facecolor="white", edgecolor="#dedede", hatch="/////", linewidth=0)
        masked = np.ma.masked_invalid(table)
        mesh = panel.pcolormesh(
            shared.x.edges,
            shared.y.edges,
            masked,
            cmap=shared.colours,
            norm=shared.norm,
            linewidth=0,
            rasterized=True,
        )
    elif inside:
        xs = [shared.x.position(point.condition) for point in inside]
        ys = [shared.y.position(point.condition) for point in inside]
        colours = [point.mean for point in inside]
        mesh = panel.scatter(
            xs, ys, c=colours, cmap=shared.colours, norm=shared.norm, s=26, edgecolor="#666666", linewidth=0.3
        )
    best = shared.view.best
    if best is not None and (panels is None or panels.bin_of(best.parameters) == number):
        panel.plot(
            shared.x.position(best.parameters),
            shared.y.position(best.parameters),
            marker="*",
            markersize=13,
            markerfacecolor=BEST,
            markeredgecolor="white",
            markeredgewidth=1.0,
            clip_on=False,
            zorder=5,
        )
    if panels is not None:
        unit = unit_text(shared.view.experiment.units.get(panels.name, ""))
        panel.set_title(f"{panels.name} {panels.name_of(number)} {unit}".rstrip())
    for spine in panel.spines.values():
        spine.set_visible(False)
    return mesh


def _edge_labels(panel: Axes, shared: _Map, number: int, rows: int, columns: int, count: int) -> None:
    units = shared.view.experiment.units
    row, column = divmod(number, columns)
    if row == rows - 1 or number + columns >= count:
        panel.set_xlabel(label(shared.x.name, units))
        panel.tick_params(labelbottom=True)
    if column == 0:
        panel.set_ylabel(label(shared.y.name, units))
    shared.x.ticks(panel.xaxis)
    shared.y.ticks(panel.yaxis)


def map_colours(points: Sequence[Point]) -> tuple[str, Normalize]:
    """Return map and scale of the colours: centred at zero where both signs occur, sequential where one does."""
    means = np.array([point.mean for point in points])
    low, high = float(means.min()), float(means.max())
    if low < 0 < high:
        most = max(-low, high)
        return DIVERGING, Normalize(-most, most)
    return SEQUENTIAL, Normalize(low, high if high > low else low + (abs(low) or 1.0))


def _draw_curve(view: RunView, points: Sequence[Point], axes: Sequence[Axis]) -> Figure:
    trials = view.best_trials
    with new_figure(7.6, 5.9 if trials else 3.9) as figure:
        rows: Any = figure.subplots(2 if trials else 1, 1, squeeze=False)
        if axes:
            _curve(rows[0][0], view, points, axes[0])
        if trials and view.channel is not None:
            draw_traces(rows[1][0], view, trials, view.channel)
            rows[1][0].set_title(f"the best condition, {len(trials)} trials over each other")
        heading(figure, view.experiment.title, _subtitle(view, points))
    return figure


def _curve(axes: Axes, view: RunView, points: Sequence[Point], axis: Axis) -> None:
    ordered = sorted(points, key=lambda point: axis.position(point.condition))
    positions = np.array([axis.position(point.condition) for point in ordered])
    for position, point in zip(positions, ordered, strict=True):
        axes.plot(
            np.full(len(point.values), position),
            point.values,
            "o",
            color=SOFT,
            markersize=3,
            alpha=0.5,
            zorder=1,
        )
        if point.ci95 is not None:
            axes.plot([position, position], point.ci95, color=COLOURS[0], linewidth=1.6, zorder=2)
    style = "o" if axis.is_words else "o-"
    axes.plot(positions, [point.mean for point in ordered], style, color=COLOURS[0], markersize=4.5, zorder=3)
    if view.best is not None:
        _mark_best(axes, view, axis.position(view.best.parameters))
    units: Mapping[str, str] = view.experiment.units
    axes.set_xlabel(label(axis.name, units))
    axes.set_ylabel(view.objective_label)
    axes.set_title("mean and 95 % interval; dots are single trials")
    axis.ticks(axes.xaxis)
    zero_line(axes)


def _mark_best(axes: Axes, view: RunView, position: float) -> None:
    best = view.best
    if best is None:
        return
    axes.plot(position, best.value, "*", markersize=13, color=BEST, markeredgecolor="white", zorder=5)
    if best.ci95 is not None:
        axes.plot([position, position], best.ci95, color=BEST, linewidth=1.2, zorder=4)
