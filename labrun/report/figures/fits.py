"""Figures of fits: overlays of a fitted model, and the panels that any other fit describes as plain data."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrun.arrays import FloatArray
from labrun.fit import Curve, FigureData, FitResult, FitSummary, Panel, Stack
from labrun.report import style
from labrun.report.statistics import root_mean_square, scaled_to_largest

_SHOWN, _ACROSS = 6, 3
_MOST_SWINGS = 24
"""More turns than this in one panel are a solid block of ink: a section is shown instead."""
_SECTION_SWINGS = 10
_STACK_WIDTH_IN, _NARROWEST_IN = 3.7, 6.0
_LEFT_IN, _RIGHT_IN, _ABOVE_IN, _BELOW_IN, _BELOW_TICKS_IN = 0.78, 0.14, 0.34, 0.5, 1.15
"""Room for labels around the panels of a stack."""
_SHARED_GAP_IN, _GAP_IN = 0.24, 0.46
_LEGEND_IN, _LEGEND_LINE_IN = 0.3, 0.17
_LEGEND_CHARACTERS_PER_IN = 15.0
_SAMPLE_CHARACTERS = 7
"""What the line before a label of the legend takes, and the space after it."""
_CHARACTERS_PER_IN = 12.0
_COLOURS = {
    "measured": "#9aa5b1", "fitted": "#c2410c", "residual": "#1d4e89", "alternative": "#0072B2",
    "limit": style.INK, "point": style.INK,
}  # fmt: skip
_DASHES = ((0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (9, 3)))
_SHADE = "#fde8d7"
_SCALED_UNITS = ("rad", "m", "V", "N", "N m", "A", "s", "m/s", "rad/s")


def fit_figure(result: FitSummary) -> Figure | None:
    """Return the figure of a fit; None if it has nothing to show."""
    if isinstance(result, FitResult):
        return draw_figure(overlays(result))
    return None if result.figure_data is None else draw_figure(result.figure_data())


def overlays(result: FitResult) -> FigureData:
    """Return measured and simulated outputs with their residual, for the trials that tell most.

    Of more than 6 trials, 6 are shown: the worst, the best and four between them in rank; the title says so.
    Signals of many swings are shown by the section around their largest residual, the residual over the whole trial.
    """
    shown, marks = shown_trials(_misfits(result))
    across = 2 if len(shown) == 4 else min(_ACROSS, len(shown))
    outputs = range(len(result.dataset.outputs))
    rows = [
        tuple(
            _overlay(result, trial, column, marks.get(trial, "")) for trial in shown[start : start + across]
        )
        for start in range(0, len(shown), across)
        for column in outputs
    ]
    return FigureData(_overlay_title(result, len(shown)), tuple(rows), legend="top", row_height_in=2.9)


def shown_trials(misfit: FloatArray, most: int = _SHOWN) -> tuple[list[int], dict[int, str]]:
    """Return the trials to show, in their own order, and which of them are the worst and the best."""
    ranked = [int(index) for index in np.argsort(-misfit, kind="stable")]
    if len(ranked) > most:
        ranked = [ranked[int(rank)] for rank in np.round(np.linspace(0, len(ranked) - 1, most))]
    marks = {ranked[-1]: "best", ranked[0]: "worst"} if len(ranked) > 1 else {}
    return sorted(ranked), marks


def draw_figure(described: FigureData) -> Figure:
    """Draw panels of curves in the report's style.

    Every stack has a cell of its own with fixed margins: a layout that measures every label takes as long as all the
    drawing.
    """
    across = max(sum(stack.width for stack in row) for row in described.rows)
    width_in = max(_STACK_WIDTH_IN * across, _NARROWEST_IN)
    title, _, subtitle = described.title.partition("\n")
    labels = {
        curve.label: None
        for row in described.rows
        for stack in row
        for panel in stack.panels
        for curve in panel.curves
        if curve.label
    }
    longest = max(map(len, labels), default=0) + _SAMPLE_CHARACTERS
    a_line = max(int(_LEGEND_CHARACTERS_PER_IN * width_in) // longest, 1)
    lines = -(-len(labels) // a_line)
    legend_in = _LEGEND_IN + _LEGEND_LINE_IN * (lines - 1) if labels and described.legend == "top" else 0.0
    head_in = style.heading_height_in(width_in, subtitle)
    height_in = described.row_height_in * len(described.rows) + head_in + legend_in
    with style.new_figure(width_in, height_in) as figure:
        figure.set_layout_engine(None)  # any engine, even an idle one, makes savefig draw twice
        style.heading(figure, title, subtitle)
        for index, row in enumerate(described.rows):
            top_in = height_in - head_in - legend_in - index * described.row_height_in
            left_in = 0.0
            for stack in row:
                cell_in = (left_in, top_in, stack.width * width_in / across, described.row_height_in)
                _draw_stack(figure, stack, cell_in, own_legend=described.legend == "panel")
                left_in += cell_in[2]
        if legend_in:
            handles: dict[str, Any] = {}
            for axes in figure.axes:
                for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                    handles.setdefault(label, handle)
            anchor = (0.01, 1.0 - head_in / height_in)
            figure.legend(
                list(handles.values()),
                list(handles),
                loc="upper left",
                bbox_to_anchor=anchor,
                ncols=-(-len(handles) // lines),
            )
    return figure


def _draw_stack(
    figure: Figure, stack: Stack, cell_in: tuple[float, float, float, float], *, own_legend: bool
) -> None:
    width, height = (float(side) for side in figure.get_size_inches())
    left_in, top_in, cell_width_in, cell_height_in = cell_in
    gap_in = (_SHARED_GAP_IN if stack.shared_x else _GAP_IN) * (len(stack.panels) - 1)
    bottom_in = _BELOW_TICKS_IN if any(panel.ticks for panel in stack.panels) else _BELOW_IN
    room_in = cell_height_in - _ABOVE_IN - bottom_in - gap_in
    unit_in = room_in / sum(panel.height for panel in stack.panels)
    edge_in, first = top_in - _ABOVE_IN, None
    for number, panel in enumerate(stack.panels, start=1):
        tall_in = panel.height * unit_in
        box = (left_in + _LEFT_IN, edge_in - tall_in, cell_width_in - _LEFT_IN - _RIGHT_IN, tall_in)
        bounds = (box[0] / width, box[1] / height, box[2] / width, box[3] / height)
        axes = figure.add_axes(bounds, sharex=first if stack.shared_x else None)
        first = first or axes
        _draw_panel(axes, panel, box[2], own_legend=own_legend)
        if stack.shared_x and number < len(stack.panels):
            axes.tick_params(labelbottom=False)
        edge_in -= tall_in + gap_in / max(len(stack.panels) - 1, 1)


def _draw_panel(axes: Axes, panel: Panel, width_in: float, *, own_legend: bool) -> None:
    if panel.shaded is not None:
        axes.axvspan(*panel.shaded, color=_SHADE, linewidth=0, zorder=0)
    if panel.zero:
        axes.axhline(0.0, color=style.SOFT, linewidth=0.7)
    for curve in panel.curves:
        _draw_curve(axes, curve)
    if "x" in panel.log:
        axes.set_xscale("log")
        style.plain_numbers(axes.xaxis)
    if "y" in panel.log:
        axes.set_yscale("log")
        style.plain_numbers(axes.yaxis)
    if panel.x_range is not None and panel.x_range[0] < panel.x_range[1]:
        axes.set_xlim(*panel.x_range)
    if panel.y_range is not None:
        axes.set_ylim(*panel.y_range)
    if panel.equal:
        axes.set_aspect("equal", adjustable="box", anchor="W")
    if panel.ticks:
        axes.set_xticks(range(len(panel.ticks)), panel.ticks, rotation=40, ha="right", fontsize=7)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.title:
        axes.set_title(_shortened(panel.title, int(_CHARACTERS_PER_IN * width_in)), fontweight="bold")
    if panel.note:
        axes.set_title(panel.note, loc="right", color=_COLOURS["residual"], fontsize=7.5, pad=3)
    if own_legend and any(curve.label for curve in panel.curves):
        axes.legend(loc="best", fontsize=7.5, handlelength=1.8)


def _draw_curve(axes: Axes, curve: Curve) -> None:
    colour = (
        style.COLOURS[curve.role % len(style.COLOURS)]
        if isinstance(curve.role, int)
        else _COLOURS[curve.role]
    )
    label = curve.label or None
    width = 2.4 if curve.bold else 0.8 if curve.role in ("measured", "residual") else 1.1
    number = curve.role if isinstance(curve.role, int) else 0
    line: Any = _DASHES[number % len(_DASHES)] if curve.dashed else "solid"
    if curve.kind == "band" and curve.spread is not None:
        axes.fill_between(curve.x, *curve.spread, color=colour, alpha=0.15, linewidth=0, label=label)
        axes.plot(curve.x, curve.y, color=colour, linewidth=width)
        return
    bars = (
        None
        if curve.spread is None
        else np.maximum([curve.y - curve.spread[0], curve.spread[1] - curve.y], 0.0)
    )
    if curve.kind == "bars":
        axes.bar(curve.x, curve.y, 0.38, yerr=bars, color=colour, label=label, error_kw={"lw": 0.7})
    elif curve.kind == "points":
        axes.errorbar(
            curve.x, curve.y, bars, color=colour, label=label, linestyle="none", marker="o", markersize=4,
            capsize=2.5, elinewidth=0.9,
        )  # fmt: skip
    else:
        steps: dict[str, Any] = {"drawstyle": "steps-post"} if curve.kind == "steps" else {}
        axes.plot(curve.x, curve.y, color=colour, linewidth=width, linestyle=line, label=label, **steps)


def _overlay(result: FitResult, trial: int, column: int, mark: str) -> Stack:
    data, output = result.dataset.trials[trial], result.dataset.outputs[column]
    time_s, measured = data.time_s, data.outputs[:, column]
    simulated, residual = result.simulated[trial][:, column], result.residuals[trial][:, column]
    whole = (float(time_s[0]), float(time_s[-1]))
    section = _section(time_s, measured, residual)
    inside = (time_s >= section[0]) & (time_s <= section[1])
    scale, unit = _scaled(result, column, output.unit)
    limit = 1.05 * scale * max(float(np.max(np.abs(part[:, column]))) for part in result.residuals) or 1.0
    rms = scale * root_mean_square(residual)
    upper = Panel(
        (
            Curve(time_s[inside], measured[inside], "measured", "measured", bold=True),
            Curve(time_s[inside], simulated[inside], "fitted", "simulated"),
        ),
        title=data.label,
        y_label=_with_unit(output.name, output.unit),
        x_range=section,
        height=2.6,
    )
    lower = Panel(
        (Curve(time_s, scale * residual, "residual", "measured \N{MINUS SIGN} simulated"),),
        note=f"RMS {rms:.3g} {unit}" + (f", {mark}" if mark else ""),
        x_label="time, s" if section == whole else "time, s (shaded: the section above)",
        y_label=_with_unit("residual", unit).replace(", ", ",\n"),
        x_range=whole,
        y_range=(-limit, limit),
        zero=True,
        shaded=None if section == whole else section,
    )
    return Stack((upper, lower), shared_x=section == whole)


def _misfits(result: FitResult) -> FloatArray:
    """Return one number a trial: its residual in units of the whole fit's, averaged over outputs."""
    total = np.array([max(result.rmse[output.name], 1e-300) for output in result.dataset.outputs])
    return np.array([root_mean_square(residual / total) for residual in result.residuals])


def _overlay_title(result: FitResult, shown: int) -> str:
    trials = len(result.dataset.trials)
    sizes = []
    for column, output in enumerate(result.dataset.outputs):
        scale, unit = _scaled(result, column, output.unit)
        sizes.append(f"{output.name} {scale * result.rmse[output.name]:.3g} {unit}")
    which = (
        f"; shown are {shown} of {trials} trials: the worst, the best, and {shown - 2} between"
        if shown < trials
        else ""
    )
    rms = f"RMS of measured \N{MINUS SIGN} simulated: {', '.join(sizes)}"
    return f"{result.model_name} fitted to {result.dataset.name}\n{rms}{which}"


def _section(time_s: FloatArray, measured: FloatArray, residual: FloatArray) -> tuple[float, float]:
    """Return the part of a trial whose overlay can be read: all of it, or some swings around the largest residual."""
    whole = (float(time_s[0]), float(time_s[-1]))
    above = measured > np.mean(measured)
    swings = int(np.count_nonzero(above[1:] != above[:-1])) // 2
    if swings <= _MOST_SWINGS:
        return whole
    length = (whole[1] - whole[0]) * _SECTION_SWINGS / swings
    width = max(int(len(time_s) * _SECTION_SWINGS / swings), 2)
    energy = np.convolve(np.square(scaled_to_largest(residual)), np.ones(width), mode="same")
    centre = float(time_s[int(np.argmax(energy))])
    start = min(max(centre - 0.5 * length, whole[0]), whole[1] - length)
    return start, start + length


def _scaled(result: FitResult, column: int, unit: str) -> tuple[float, str]:
    """Return factor and unit in which the residual reads well: mrad for rad, mm for m, and so on."""
    size = max(float(np.max(np.abs(part[:, column]))) for part in result.residuals)
    if unit in _SCALED_UNITS and 0.0 < size < 0.1:
        return (1e3, f"m{unit}") if size >= 1e-4 else (1e6, f"\N{GREEK SMALL LETTER MU}{unit}")
    return 1.0, unit


def _with_unit(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name}, {unit}"


def _shortened(label: str, most: int) -> str:
    return label if len(label) <= most else f"{label[: most - 1]}\N{HORIZONTAL ELLIPSIS}"
