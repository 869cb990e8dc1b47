"""The picture of a design: predicted steps, the drive, the open loop around -1, the reference followed."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.result import Curve, FigureData, Panel, Stack
from labrun.fit.tuning.closed_loop import UNBOUNDED
from labrun.fit.tuning.designs import ControllerDesign
from labrun.fit.tuning.study import Study

_MOST = 5


def design_figure(study: Study, title: str) -> FigureData:
    """Return step and drive of the designs, Nyquist curves with margins, and tracking if there is any."""
    shown = shown_designs(study)
    rows: list[tuple[Stack, ...]] = [
        (Stack(_step_panels(study, shown), width=1.5), Stack((_nyquist(study, shown),), width=1.5))
    ]
    if study.errors:
        rows.append(tuple(Stack((panel,), width=1.5) for panel in _following(study, shown)))
    return FigureData(title, tuple(rows), legend="top", row_height_in=4.2)


def shown_designs(study: Study) -> list[ControllerDesign]:
    """Return the stable designs, at most 5: the best, up to 4 that were given, and those that come next to the best."""
    stable = [one for one in study.designs if one.margins.stable]
    written = [one for one in stable if one.source == "given"][: _MOST - 1]
    made = sorted(
        (one for one in stable if one.source != "given"),
        key=lambda one: (one.name != study.best, study.scores[one.name]),
    )
    best, others = (made[:1], made[1:]) if study.best else ([], made)
    return [*best, *written, *others][:_MOST]


def _curve(
    study: Study,
    place: int,
    design: ControllerDesign,
    x: FloatArray,
    y: FloatArray,
    kind: Literal["line", "steps"] = "line",
) -> Curve:
    """Return a curve in the look of its design: the recommended one bold, those that were given dashed."""
    best = design.name == study.best
    label = f"{design.name} *" if best else design.name
    return Curve(x, y, place, label, kind, bold=best, dashed=design.source == "given")


def _step_panels(study: Study, shown: Sequence[ControllerDesign]) -> tuple[Panel, Panel]:
    plant = study.loop.plant
    settled = [one.figures.settling_s for one in shown if np.isfinite(one.figures.settling_s)]
    # most of the designs to their end; one slow integral must not squeeze the others
    until = 1.6 * float(np.median(settled)) if settled else float(shown[0].step.time_s[-1]) if shown else 1.0
    until = max(until, 6.0 * study.loop.delay_s)
    outputs, drives = [], []
    for place, one in enumerate(shown):
        inside = one.step.time_s <= until
        time_s = one.step.time_s[inside]
        outputs.append(_curve(study, place, one, time_s, one.step.output[inside]))
        drives.append(_curve(study, place, one, time_s, one.step.drive[inside], "steps"))
    highest = max([1.0, *(float(np.max(curve.y)) for curve in outputs)])
    # the first value of a derivative is a kick that would hide the rest
    values = np.concatenate([one.step.drive[1:] for one in shown]) if shown else np.zeros(1)
    room = 0.12 * float(np.ptp(values) or 1.0)
    level = Curve(np.array([0.0, until]), np.ones(2), "limit", dashed=True)
    return (
        Panel(
            (*outputs, level),
            title="predicted step of the reference",
            y_label=f"output, {plant.output_unit}\nper {plant.output_unit}",
            x_range=(0.0, until),
            y_range=(-0.05, 1.08 * highest),
            height=1.5,
        ),
        Panel(
            tuple(drives),
            x_label="time, s",
            y_label=f"drive, {plant.input_unit}\nper {plant.output_unit}",
            x_range=(0.0, until),
            y_range=(min(0.0, float(np.min(values))) - 0.3 * room, float(np.max(values)) + room),
        ),
    )


def _nyquist(study: Study, shown: Sequence[ControllerDesign]) -> Panel:
    settings, loop = study.settings, study.loop
    angle = np.linspace(0, 2 * np.pi, 361)
    # what the margins that were asked for forbid
    spare = np.radians(settings.phase_margin_deg)
    wedge = np.linspace(np.pi - spare, np.pi + spare, 61)
    limits = [
        Curve(np.cos(angle), np.sin(angle), "limit", dashed=True),
        Curve(np.cos(wedge), np.sin(wedge), "limit", bold=True),
        Curve(np.array([-1.6, -1.0 / settings.gain_margin]), np.zeros(2), "limit", bold=True),
        Curve(np.array([-1.0]), np.zeros(1), "limit", kind="points"),
    ]
    curves = []
    for place, one in enumerate(shown):
        curve = one.gains.frequency_response(loop.grid_rad_s, loop.step_s) * loop.grid_response
        curves.append(_curve(study, place, one, curve.real, curve.imag))
        if one.margins.gain < 1e3:
            curves.append(Curve(np.array([-1.0 / one.margins.gain]), np.zeros(1), place, kind="points"))
    return Panel(
        (*limits, *curves),
        title=f"open loop at {settings.rate_hz:g} Hz; black: margins {settings.gain_margin:g}, "
        f"{settings.phase_margin_deg:g}\N{DEGREE SIGN}",
        x_label="real part of the open loop",
        y_label="imaginary part",
        x_range=(-1.6, 1.6),
        y_range=(-1.9, 1.1),
        equal=True,
    )


def _following(study: Study, shown: Sequence[ControllerDesign]) -> tuple[Panel, ...]:
    """Return the reference followed, and its error, on a plant whose gain is below the model's."""
    reference, plant, settings = study.settings.reference, study.loop.plant, study.settings
    if reference is None or not shown:
        return ()
    tracks = [one.follow(reference, settings.range or UNBOUNDED, 1.0 - settings.gain_error) for one in shown]
    outputs = [
        _curve(study, place, one, track.time_s, track.output)
        for place, (one, track) in enumerate(zip(shown, tracks, strict=True))
    ]
    errors = [
        _curve(study, place, one, track.time_s, track.reference - track.output)
        for place, (one, track) in enumerate(zip(shown, tracks, strict=True))
    ]
    wanted = Curve(tracks[-1].time_s, tracks[-1].reference, "limit", dashed=True)
    span = (0.0, float(tracks[-1].time_s[-1]))
    less = f", gain {settings.gain_error:.0%} below the model's" if settings.gain_error else ""
    within = (
        f", drive within {settings.range[0]:g} ... {settings.range[1]:g} {plant.input_unit}"
        if settings.range
        else ""
    )
    unit = plant.output_unit
    return (
        Panel(
            (*outputs, wanted),
            title=f"reference followed{less}",
            x_label="time, s",
            y_label=f"output, {unit}",
            x_range=span,
        ),
        Panel(
            tuple(errors),
            title=f"its error{within}",
            x_label="time, s",
            y_label=f"reference less output, {unit}",
            x_range=span,
            zero=True,
        ),
    )
