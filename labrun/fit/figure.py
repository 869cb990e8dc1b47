"""The picture of a fit: measured and simulated, and what is left, for the trials that tell most."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from labrun.fit.result import FitResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FloatArray = NDArray[np.float64]

_SHOWN = 6
_ACROSS = 3
_MOST_SWINGS = 24
"""More turns than this in one panel are a solid block of ink: a section is shown instead."""
_SECTION_SWINGS = 10
# inches; a layout that measures every label takes as long as all the drawing
_CELL = (3.7, 2.85)
_HEADING = 0.6
_MARGIN = 0.72
_PANELS = ((1.72, 1.5), (2.44, 0.52))
"""How far the lower edges of overlay and residual lie below the cell's upper one, and how high they are."""
_MEASURED, _SIMULATED, _LEFT, _INK, _GRID = "#9aa5b1", "#c2410c", "#1d4e89", "#1f2933", "#e4e7eb"
_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans", "font.size": 8.5, "axes.edgecolor": "#7b8794", "axes.linewidth": 0.6,
    "axes.labelcolor": _INK, "text.color": _INK, "xtick.color": "#52606d", "ytick.color": "#52606d",
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 2.5, "ytick.major.size": 2.5,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": _GRID, "grid.linewidth": 0.6,
    "axes.axisbelow": True, "legend.frameon": False, "figure.facecolor": "white", "axes.titlesize": 8.5,
}  # fmt: skip


def draw_fit(result: FitResult, path: Path) -> Path:
    """Draw overlay and residual of each output, and write a PNG.

    Of more than 6 trials, 6 are shown: the worst, the best and four between them in rank; the title says so.
    Signals of many swings are shown by the section around their largest residual, the residual over the whole trial.

    Returns
    -------
    Path
        `path`, its folder made if needed.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    misfit = _misfits(result)
    shown, marks = shown_trials(misfit)
    outputs = result.dataset.outputs
    across = min(_ACROSS, len(shown)) if len(shown) != 4 else 2
    rows = -(-len(shown) // across) * len(outputs)
    width, height = max(_CELL[0] * across, 5.5), _CELL[1] * rows + _HEADING
    with rc_context(cast("Any", _STYLE)):
        figure = Figure(figsize=(width, height), dpi=150)
        FigureCanvasAgg(figure)
        for place, trial in enumerate(shown):
            for column in range(len(outputs)):
                row, of_row = (place // across) * len(outputs) + column, place % across
                left, top = of_row * width / across, height - _HEADING - row * _CELL[1]
                _panel(
                    [
                        figure.add_axes(
                            (
                                (left + _MARGIN) / width,
                                (top - below) / height,
                                (width / across - _MARGIN - 0.12) / width,
                                tall / height,
                            )
                        )
                        for below, tall in _PANELS
                    ],
                    result,
                    trial,
                    column,
                    marks.get(trial, ""),
                    first=place == 0 and column == 0,
                    left=of_row == 0,
                )
        figure.text(
            0.1 / width, 1 - 0.1 / height, _title(result, len(shown)), fontsize=10, va="top", linespacing=1.5
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, format="png", pil_kwargs={"compress_level": 3})
    return path


def shown_trials(misfit: FloatArray, most: int = _SHOWN) -> tuple[list[int], dict[int, str]]:
    """Return the trials to show, in their own order, and which of them are the worst and the best."""
    ranked = [int(index) for index in np.argsort(-misfit, kind="stable")]
    if len(ranked) > most:
        ranked = [ranked[int(place)] for place in np.round(np.linspace(0, len(ranked) - 1, most))]
    marks = {ranked[-1]: "best", ranked[0]: "worst"} if len(ranked) > 1 else {}
    return sorted(ranked), marks


def _misfits(result: FitResult) -> FloatArray:
    """Return one number a trial: its residual in units of the whole fit's, averaged over outputs."""
    total = np.array([max(result.rmse[output.name], 1e-300) for output in result.dataset.outputs])
    return np.array(
        [float(np.sqrt(np.mean(np.mean(part**2, axis=0) / total**2))) for part in result.residuals]
    )


def _title(result: FitResult, shown: int) -> str:
    trials = len(result.dataset.trials)
    sizes = []
    for column, output in enumerate(result.dataset.outputs):
        scale, unit = _scaled(result, column, output.unit)
        sizes.append(f"{output.name} {scale * result.rmse[output.name]:.3g} {unit}")
    rmse = ", ".join(sizes)
    which = (
        f"; shown are {shown} of {trials} trials: the worst, the best, and {shown - 2} between"
        if shown < trials
        else ""
    )
    heading = f"{result.model_name} fitted to {result.dataset.name}"
    return f"{heading}\nRMS of measured \N{MINUS SIGN} simulated: {rmse}{which}"


def _panel(
    axes: "Sequence[Axes]",
    result: FitResult,
    trial: int,
    column: int,
    mark: str,
    *,
    first: bool,
    left: bool,
) -> None:
    data = result.dataset.trials[trial]
    output = result.dataset.outputs[column]
    time_s, measured = data.time_s, data.outputs[:, column]
    residual = result.residuals[trial][:, column]
    overlay, rest = axes
    section = _section(time_s, measured, residual)
    inside = (time_s >= section[0]) & (time_s <= section[1])
    overlay.plot(
        time_s[inside],
        measured[inside],
        color=_MEASURED,
        linewidth=2.6,
        label="measured",
        solid_capstyle="round",
    )
    overlay.plot(
        time_s[inside],
        result.simulated[trial][inside, column],
        color=_SIMULATED,
        linewidth=1.0,
        label="simulated",
    )
    overlay.set_xlim(*section)
    low, high = float(np.min(measured[inside])), float(np.max(measured[inside]))
    room = 0.08 * (high - low) or 1.0
    simulated = result.simulated[trial][inside, column]
    overlay.set_ylim(min(low, float(np.min(simulated))) - room, max(high, float(np.max(simulated))) + room)
    scale, unit = _scaled(result, column, output.unit)
    rest.axhline(0.0, color="#7b8794", linewidth=0.6)
    rest.plot(time_s, scale * residual, color=_LEFT, linewidth=0.7)
    rest.set_xlim(float(time_s[0]), float(time_s[-1]))
    limit = 1.05 * scale * max(float(np.max(np.abs(part[:, column]))) for part in result.residuals)
    rest.set_ylim(-(limit or 1.0), limit or 1.0)
    whole = section == (float(time_s[0]), float(time_s[-1]))
    if whole:
        overlay.tick_params(labelbottom=False)
    else:
        rest.axvspan(*section, color="#fde8d7", linewidth=0, zorder=0)
    rest.set_xlabel("time, s" if whole else "time, s (shaded: the section above)")
    if left:
        overlay.set_ylabel(_with_unit(output.name, output.unit))
        rest.set_ylabel(_with_unit("residual", unit).replace(", ", ",\n"))
    rms = float(np.sqrt(np.mean(residual**2)))
    note = f"RMS {scale * rms:.3g} {unit}" + (f", {mark}" if mark else "")
    overlay.set_title(_shortened(data.label), loc="left", fontweight="bold")
    rest.set_title(note, loc="right", color=_LEFT, fontsize=7.5, pad=3)
    if first:
        _legend(overlay)


def _legend(axes: "Axes") -> None:
    axes.legend(
        loc="upper right", ncols=2, fontsize=7.5, handlelength=1.4, borderaxespad=0.2, columnspacing=1.0
    )
    # room for it above the curves, instead of on them
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.22 * (high - low))


def _section(time_s: FloatArray, measured: FloatArray, residual: FloatArray) -> tuple[float, float]:
    """Return the part of a trial whose overlay can be read: all of it, or some swings around the largest residual."""
    whole = (float(time_s[0]), float(time_s[-1]))
    above = measured > np.mean(measured)
    swings = int(np.count_nonzero(above[1:] != above[:-1])) // 2
    if swings <= _MOST_SWINGS:
        return whole
    length = (whole[1] - whole[0]) * _SECTION_SWINGS / swings
    width = max(int(len(time_s) * _SECTION_SWINGS / swings), 2)
    energy = np.convolve(residual**2, np.ones(width), mode="same")
    centre = float(time_s[int(np.argmax(energy))])
    start = min(max(centre - 0.5 * length, whole[0]), whole[1] - length)
    return start, start + length


def _scaled(result: FitResult, column: int, unit: str) -> tuple[float, str]:
    """Return factor and unit in which the residual reads well: mrad for rad, mm for m, and so on."""
    size = max(float(np.max(np.abs(part[:, column]))) for part in result.residuals)
    if unit in ("rad", "m", "V", "N", "N m", "A", "s", "m/s", "rad/s") and 0.0 < size < 0.1:
        return (1e3, f"m{unit}") if size >= 1e-4 else (1e6, f"\N{GREEK SMALL LETTER MU}{unit}")
    return 1.0, unit


def _with_unit(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name}, {unit}"


def _shortened(label: str) -> str:
    return label if len(label) <= 44 else f"{label[:43]}\N{HORIZONTAL ELLIPSIS}"
