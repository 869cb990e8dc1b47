"""The picture of a design: predicted steps, the drive, the open loop around -1, the reference followed."""

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from labrun.fit.figure import _STYLE
from labrun.fit.tuning.designs import Design, HalfSine
from labrun.fit.tuning.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#6a51a3")
"""Okabe & Ito (2008), told apart by all common kinds of colour vision; as in the report's figures."""
_DASHES = ((0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (9, 3)))
"""Of the designs that were given; the others are drawn through."""
_MOST = len(_COLOURS)
_INK, _FAINT = "#1f2933", "#7b8794"


def draw_designs(study: Study, title: str) -> "Figure":
    """Return the figure: step and drive of the designs, Nyquist curves with margins, and tracking if there is any."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = shown_designs(study)
    looks = _looks(shown, study)
    rows = 2 if study.errors else 1
    with rc_context(cast("Any", _STYLE)):
        figure = Figure(figsize=(10.5, 1.35 + 3.75 * rows), dpi=150)
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(
            rows, 2, left=0.07, right=0.985, bottom=0.09 if rows == 2 else 0.15,
            top=1.0 - 1.15 / (1.35 + 3.75 * rows), wspace=0.2, hspace=0.32,
        )  # fmt: skip
        left = grid[0, 0].subgridspec(2, 1, height_ratios=(1.5, 1), hspace=0.12)
        upper, lower = figure.add_subplot(left[0]), figure.add_subplot(left[1])
        _step(upper, lower, study, shown, looks)
        _nyquist(figure.add_subplot(grid[0, 1]), study, shown, looks)
        if study.errors:
            _follow(figure.add_subplot(grid[1, 0]), study, shown, looks, error=False)
            _follow(figure.add_subplot(grid[1, 1]), study, shown, looks, error=True)
        height = figure.get_size_inches()[1]
        figure.text(0.012, 1 - 0.1 / height, title, fontsize=10, va="top", linespacing=1.5)
        handles, labels = upper.get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="upper left", bbox_to_anchor=(0.06, 1 - 0.52 / height), ncols=len(labels),
            fontsize=8, handlelength=2.6, columnspacing=1.3,
        )  # fmt: skip
    return figure


def shown_designs(study: Study) -> list[Design]:
    """Return the stable designs, at most 5: the best, up to 4 that were given, and those that come next to the best."""
    stable = [one for one in study.designs if one.margins.stable]
    written = [one for one in stable if one.source == "given"][: _MOST - 1]
    made = sorted(
        (one for one in stable if one.source != "given"),
        key=lambda one: (one.name != study.best, study.scores[one.name]),
    )
    best, others = (made[:1], made[1:]) if study.best else ([], made)
    return [*best, *written, *others][:_MOST]


def _looks(shown: list[Design], study: Study) -> dict[str, dict[str, Any]]:
    """Return colour, width and dashes of each design's lines."""
    dashes = iter(_DASHES)
    return {
        one.name: {
            "color": colour,
            "linewidth": 2.2 if one.name == study.best else 1.2,
            "linestyle": next(dashes) if one.source == "given" else "solid",
        }
        for one, colour in zip(shown, _COLOURS, strict=False)
    }


def _step(
    upper: "Axes", lower: "Axes", study: Study, shown: list[Design], looks: dict[str, dict[str, Any]]
) -> None:
    plant = study.loop.plant
    settled = [one.figures.settling_s for one in shown if np.isfinite(one.figures.settling_s)]
    # most of the designs to their end; one slow integral must not squeeze the others
    until = 1.6 * float(np.median(settled)) if settled else float(shown[0].step.time_s[-1]) if shown else 1.0
    until = max(until, 6.0 * study.loop.delay_s)
    highest = 1.0
    for one in shown:
        track = one.step
        inside = track.time_s <= until
        highest = max(highest, float(np.max(track.output[inside])))
        label = f"{one.name} *" if one.name == study.best else one.name
        upper.plot(
            track.time_s[inside],
            track.output[inside],
            label=label,
            **looks[one.name],
        )
        lower.step(
            track.time_s[inside], track.drive[inside], where="post", **looks[one.name],
        )  # fmt: skip
    upper.axhline(1.0, color=_INK, linewidth=0.7, linestyle=(0, (4, 3)))
    upper.set_ylim(-0.05, 1.08 * highest)
    drives = np.concatenate([one.step.drive[1:] for one in shown]) if shown else np.zeros(1)
    room = 0.12 * float(np.ptp(drives) or 1.0)
    lower.set_ylim(min(0.0, float(np.min(drives))) - 0.3 * room, float(np.max(drives)) + room)
    upper.tick_params(labelbottom=False)
    for axes in (upper, lower):
        axes.set_xlim(0.0, until)
    upper.set_title("predicted step of the reference", loc="left", fontweight="bold")
    upper.set_ylabel(f"output, {plant.output_unit}\nper {plant.output_unit}")
    lower.set_ylabel(f"drive, {plant.input_unit}\nper {plant.output_unit}")
    lower.set_xlabel("time, s")


def _nyquist(axes: "Axes", study: Study, shown: list[Design], looks: dict[str, dict[str, Any]]) -> None:
    settings = study.settings
    angle = np.linspace(0, 2 * np.pi, 361)
    axes.plot(np.cos(angle), np.sin(angle), color=_FAINT, linewidth=0.7, linestyle=(0, (4, 3)))
    axes.plot([-1.0], [0.0], marker="+", markersize=9, color=_INK, markeredgewidth=1.4)
    # what the margins that were asked for forbid
    spare = np.radians(settings.phase_margin_deg)
    wedge = np.linspace(np.pi - spare, np.pi + spare, 61)
    axes.plot(np.cos(wedge), np.sin(wedge), color=_INK, linewidth=2.2, solid_capstyle="butt")
    axes.plot(
        [-1.6, -1.0 / settings.gain_margin], [0.0, 0.0], color=_INK, linewidth=2.2, solid_capstyle="butt"
    )
    for one in shown:
        curve = (
            one.gains.frequency_response(study.loop.grid_rad_s, study.loop.step_s) * study.loop.grid_response
        )
        axes.plot(curve.real, curve.imag, **looks[one.name])
        if one.margins.gain < 1e3:
            axes.plot(
                [-1.0 / one.margins.gain], [0.0], marker="o", markersize=3.5, color=looks[one.name]["color"]
            )
    axes.text(-1.06, 0.08, "\N{MINUS SIGN}1", ha="right", fontsize=8)
    axes.set_xlim(-1.6, 1.6)
    axes.set_ylim(-1.9, 1.1)
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set_xlabel("real part of the open loop")
    axes.set_ylabel("imaginary part")
    axes.set_title(
        f"open loop at {settings.rate_hz:g} Hz; black: gain margin {settings.gain_margin:g}, "
        f"phase margin {settings.phase_margin_deg:g}\N{DEGREE SIGN}",
        loc="left",
        fontweight="bold",
    )


def _follow(
    axes: "Axes", study: Study, shown: list[Design], looks: dict[str, dict[str, Any]], *, error: bool
) -> None:
    table = study.settings.reference
    if table is None:
        return
    plant = study.loop.plant
    reference = HalfSine(table.low, table.high, table.period_s)
    bounds = study.settings.range or (-1e12, 1e12)
    wrong = 1.0 - study.settings.gain_error
    time_s = None
    for one in shown:
        track = one.follow(reference, bounds, wrong)
        values = track.reference - track.output if error else track.output
        axes.plot(track.time_s, values, **looks[one.name])
        time_s = track.time_s
        wanted = track.reference
    if time_s is None:
        return
    axes.set_xlim(0.0, float(time_s[-1]))
    axes.set_xlabel("time, s")
    less = (
        f", plant's gain {study.settings.gain_error:.0%} below the model's"
        if study.settings.gain_error
        else ""
    )
    if error:
        axes.axhline(0.0, color=_INK, linewidth=0.7)
        axes.set_ylabel(f"reference less output, {plant.output_unit}")
        within = (
            f", drive within {bounds[0]:g} ... {bounds[1]:g} {plant.input_unit}"
            if study.settings.range
            else ""
        )
        axes.set_title(f"its error{within}", loc="left", fontweight="bold")
        return
    axes.plot(time_s, wanted, color=_INK, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.set_ylabel(f"output, {plant.output_unit}")
    axes.set_title(f"reference followed{less}", loc="left", fontweight="bold")
