"""The designs in tables, in sentences and as a picture."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.result import Curve, FigureData, Panel, Stack, TextTable
from labrun.fit.tuning.designs import MOST_OVERSHOOT, ControllerDesign, Errors, Study, lost
from labrun.fit.tuning.loop import OpenLoop, ultimate
from labrun.fit.tuning.response import UNBOUNDED

_CATCHES_UP = 1.6
"""First arch over second, above which a controller only follows after the first."""
_FOLLOWS = 0.1
"""Mean error over the mean of the reference, below which a controller follows it."""
_NEAR_END = 0.02
"""Part of what the drive reaches by which a reference may leave it: the gain is not known better."""


def tables(study: Study) -> tuple[TextTable, ...]:
    """Return gains, margins, predicted step, and, where there is a reference, errors."""
    unit, rate = drive_per_output(study), study.settings.rate_hz
    gains, kept, steps = [], [], []
    for design in study.designs:
        name, own, margins, spread = (
            _name(design, study),
            design.gains,
            design.margins,
            study.spreads.get(design.name),
        )
        numbers = (own.p, own.i_per_s, own.i_per_sample(rate), own.d_s)
        filtered = _number(own.filter_s) if own.d_s else "-"
        ahead = "-" if own.feedforward is None else _number(own.feedforward)
        gains.append((name, design.structure, *map(_number, numbers), filtered, ahead))
        between = (
            ("-", "-") if spread is None else (_interval(spread.gain, 2), _interval(spread.phase_deg, 0))
        )
        crossover = _number(margins.crossover_rad_s) if margins.crossover_rad_s else "none"
        kept.append((
            name, _margin(margins.gain), between[0], _margin(margins.phase_deg), between[1], _margin(margins.delay_s),
            _number(margins.sensitivity), crossover, "yes" if margins.stable else "NO",
        ))  # fmt: skip
        if margins.stable:
            figures = design.figures
            off = f"{100 * figures.steady_error:.1f} %"
            steps.append((
                name, f"{100 * figures.overshoot:.1f} %", _settling(figures.settling_s), off,
                _number(figures.peak_drive), _number(design.noise_gain),
            ))  # fmt: skip
    found_tables = [
        TextTable(
            with_unit("gains", unit, ", "),
            ("", "structure", "P", "I per s", f"I per sample ({rate:g} Hz)", "D s", "filter s", "FF"),
            tuple(gains),
        ),
        TextTable(
            "margins of the loop as it runs (95 %: over the fit's own uncertainty; none: nothing to lose, no crossing)",
            ("", "gain", "95 %", "phase, deg", "95 %", "delay, s", "Ms", "crossover, rad/s", "stable"),
            tuple(kept),
        ),
        TextTable(
            "predicted step of the reference, drive without bounds",
            (
                "", "overshoot", "settles (2 %), s", "stays off by", with_unit("peak drive", unit, ", "),
                with_unit("drive noise", unit, ", "),
            ),
            tuple(steps),
        ),
    ]  # fmt: skip
    return (*found_tables, _tracking(study)) if study.errors else tuple(found_tables)


def _tracking(study: Study) -> TextTable:
    unit = study.loop.plant.output_unit
    factors = next(iter(study.errors.values())).keys()
    header = [""]
    for factor in factors:
        label = "as fitted" if factor == 1.0 else f"{factor - 1:+.0%}"
        header += [f"gain {label}: 1st", "2nd"]
    rows = [
        (_name(study.named(name), study), *(f"{value:.4f}" for pair in errors.values() for value in pair))
        for name, errors in study.errors.items()
    ]
    title = with_unit("mean error over the first and second arch of the reference", unit, ", ")
    return TextTable(title, tuple(header), tuple(rows))


def _name(design: ControllerDesign, study: Study) -> str:
    return f"{design.name} *" if design.name == study.best else design.name


def _number(value: float) -> str:
    if math.isinf(value):
        return "inf"
    return "0" if value == 0 else f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"


def _settling(value: float) -> str:
    return "not in time" if math.isinf(value) else _number(value)


def _margin(value: float) -> str:
    return "none" if math.isinf(value) else _number(value)


def _interval(ends: tuple[float, float], decimals: int) -> str:
    if all(math.isinf(end) for end in ends):
        return ""  # the margin beside it says none
    low, high = ends
    if math.isinf(high):
        return f"{low:.{decimals}f} or more"  # some of the resampled plants have nothing to lose
    return f"{low:.{decimals}f} ... {high:.{decimals}f}"


def findings(study: Study) -> list[str]:
    """Return what the designs show, the recommendation first."""
    sentences = [*_recommended(study), *_limits(study.loop, study), *_proportional(study)]
    sentences += [
        sentence
        for design in study.designs
        if design.source == "given"
        for sentence in _verdict(design, study)
    ]
    return sentences


def warnings(study: Study) -> list[str]:
    """Return what to know before a design is trusted."""
    messages, settings = list(study.warnings), study.settings
    for design in study.designs:
        margins, spread = design.margins, study.spreads.get(design.name)
        short = margins.gain < settings.gain_margin or margins.phase_deg < settings.phase_margin_deg
        if not margins.stable:
            messages.append(
                f"{design.name} is unstable on this plant: its gain would have to be below {margins.gain:.2g} of "
                "what it is; nothing is predicted of it"
            )
        elif spread is not None and lost(spread):
            messages.append(
                f"{design.name} may lose its margin within the fit's 95 % interval: gain margin "
                f"{spread.gain[0]:.2f} ... {spread.gain[1]:.2f}, unstable on {spread.unstable_share:.0%} of "
                f"{spread.plants} resampled plants; measure more steps, or ask for a larger gain_margin"
            )
        if margins.stable and design.source == "simc" and short:
            messages.append(
                f"{design.name} has a gain margin of {margins.gain:.2f} and a phase margin of "
                f"{margins.phase_deg:.0f} deg: "
                "SIMC keeps none of the requested margins; a larger tau_c_s gives more"
            )
    messages += _out_of_range(study)
    if study.best is None:
        calm = (
            f" without overshooting a step by more than {MOST_OVERSHOOT:.0%} (where the reference is slower than "
            "a step, say which it is: reference)"
        )
        messages.append(
            "no design keeps the requested margins on all plants within the fit's 95 % interval"
            f"{'' if settings.reference else calm}: none is recommended"
        )
    return messages


def _recommended(study: Study) -> Iterator[str]:
    if study.best is None:
        return
    design, unit = study.named(study.best), study.loop.plant.output_unit
    margins = design.margins
    among = "its error after steps of reference and load is the least, or near it"
    if study.errors:
        among = (
            f"on the reference its mean error is at most {study.scores[study.best]:.2g} {unit} with the plant's gain "
            f"off by {study.settings.gain_error:.0%} either way"
        )
    finite = math.isfinite(margins.delay_s)
    late = f", delay margin {margins.delay_s:.2f} s" if finite else ", and no dead time unsettles it"
    yield (
        f"take {design.name} ({design.structure}): {among}; of the designs within 20 % of the least error it passes "
        f"least noise to the drive; gain margin {margins.gain:.2f}{late}"
    )
    if design.gains.feedforward is not None:
        yield (
            "the feed-forward carries the reference, so the feedback only corrects the error of the model "
            "and need not wait for the integral to build up"
        )
    if design.figures.overshoot > MOST_OVERSHOOT:
        yield (
            f"{design.name} is for a reference that moves slowly against the loop's {study.loop.delay_s:.2f} s of dead "
            f"time: a step of it would overshoot by {design.figures.overshoot:.0%}, because the feedback takes for an "
            "error what has only not arrived yet" + _calmest(study)
        )


def _calmest(study: Study) -> str:
    """Return which design a step suits best."""
    settled = [
        design
        for design in study.designs
        if design.source != "given"
        and design.margins.stable
        and design.gains.i_per_s
        and design.figures.overshoot < MOST_OVERSHOOT
        and math.isfinite(design.figures.settling_s)
    ]
    if not settled:
        return ""
    design = min(settled, key=lambda item: item.figures.settling_s)
    overshoot, settling_s = design.figures.overshoot, design.figures.settling_s
    return f"; for references that jump there is {design.name}, {overshoot:.0%} and settled after {settling_s:.1f} s"


def _limits(loop: OpenLoop, study: Study) -> Iterator[str]:
    unit = drive_per_output(study)
    bare, bare_omega = ultimate(OpenLoop(loop.plant))
    real, real_omega = ultimate(loop)
    message = f"ultimate gain of the plant alone {with_unit(f'{bare:.4g}', unit)} at {bare_omega:.3g} rad/s"
    if loop.average_s:
        mean, mean_omega = ultimate(OpenLoop(loop.plant, average_s=loop.average_s))
        message += (
            f"; with the mean over {loop.average_s:.3g} s as feedback {mean:.4g} at {mean_omega:.3g} rad/s"
        )
    yield f"{message}; of the loop at {loop.rate_hz:g} Hz {real:.4g} at {real_omega:.3g} rad/s"
    parts = [f"{loop.plant.dead_s:.3f} s dead time"]
    parts += [f"{0.5 * loop.average_s:.3f} s half of the mean"] if loop.average_s else []
    parts += [f"{0.5 * loop.step_s:.3f} s half a sample"]
    parts += [f"{loop.compute_s:.3f} s computation"] if loop.compute_s else []
    yield f"effective dead time of the loop {loop.delay_s:.3f} s: {', '.join(parts)}"


def _proportional(study: Study) -> Iterator[str]:
    gain, unit = study.loop.gain, drive_per_output(study)
    kept = ", ".join(
        f"{design.name} {design.steady_error:.0%} (P = {with_unit(f'{design.gains.p:.4g}', unit)})"
        for design in study.designs
        if design.structure == "P" and design.source != "given" and design.margins.stable
    )
    if kept:
        yield (
            f"P alone leaves 1/(1 + K P) of the reference for ever: {kept}; "
            f"P = {with_unit(f'{1 / gain:.4g}', unit)} = 1/K would leave half"
        )


def _verdict(design: ControllerDesign, study: Study) -> Iterator[str]:
    if not design.margins.stable or design.name not in study.errors or study.settings.reference is None:
        return
    unit, errors = study.loop.plant.output_unit, study.errors[design.name]
    table = study.settings.reference
    middle = table.low + (table.high - table.low) * 0.6366  # mean of |sin|
    first, second = errors[1.0]
    worst = max(max(pair) for pair in errors.values())
    numbers = f"mean error {first:.2g} {unit} over the first arch, {second:.2g} over the second"
    off = _off(errors, study)
    left = design.steady_error
    if min(first, second) > _FOLLOWS * middle and first < _CATCHES_UP * second:
        kind = f"leaves {left:.0%} of the reference" if left > 0.05 else "is too slow to follow"
        yield f"{design.name} {kind}: {numbers}"
    elif first > _CATCHES_UP * second and first > _FOLLOWS * middle:
        yield f"{design.name} misses the first arch and follows afterwards: {numbers}"
    elif design.gains.feedforward is not None and not design.gains.i_per_s:
        yield (
            f"{design.name} follows from the first arch: {numbers}; but with the model's gain {off} it stays off "
            "for good"
        )
    elif worst <= 2.0 * _FOLLOWS * middle:
        yield f"{design.name} follows from the first arch: {numbers}; with the model's gain {off}"
    else:
        yield f"{design.name}: {numbers}; with the model's gain {off}"


def _off(errors: Errors, study: Study) -> str:
    """Return what the error is where the model's gain is wrong."""
    others = {factor: pair for factor, pair in errors.items() if factor != 1.0}
    if not others:
        return "as fitted"
    pair = max(others.values(), key=sum)
    unit = study.loop.plant.output_unit
    return f"off by {study.settings.gain_error:.0%} (then {pair[0]:.2g} and {pair[1]:.2g} {unit})"


def _out_of_range(study: Study) -> Iterator[str]:
    settings = study.settings
    if settings.reference is None or settings.range is None:
        return
    gain, plant = study.loop.gain, study.loop.plant
    ends = sorted((gain * settings.range[0], gain * settings.range[1]))
    low, high = sorted((settings.reference.low, settings.reference.high))
    room = _NEAR_END * (ends[1] - ends[0])
    if low < ends[0] - room or high > ends[1] + room:
        yield (
            f"the reference, {low:.3g} ... {high:.3g} {plant.output_unit}, leaves what the drive reaches within its "
            f"range {settings.range[0]:g} ... {settings.range[1]:g} {plant.input_unit}: {ends[0]:.3g} ... "
            f"{ends[1]:.3g} {plant.output_unit}"
        )


def drive_per_output(study: Study) -> str:
    """Return the unit of a proportional gain: ``deg/N``."""
    plant = study.loop.plant
    return per(plant.input_unit, plant.output_unit)


def per(above: str, below: str) -> str:
    """Return a unit over a unit."""
    if above == below:
        return "1"
    return above if below == "1" else f"{above}/{below}"


def with_unit(text: str, unit: str, between: str = " ") -> str:
    """Return a text with its unit, if it has one."""
    return text if unit in ("", "1") else f"{text}{between}{unit}"


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
    stable = [design for design in study.designs if design.margins.stable]
    written = [design for design in stable if design.source == "given"][: _MOST - 1]
    made = [design for design in stable if design.source != "given"]
    made.sort(key=lambda design: (design.name != study.best, study.scores[design.name]))
    best, others = (made[:1], made[1:]) if study.best else ([], made)
    return [*best, *written, *others][:_MOST]


def _curve(
    study: Study,
    index: int,
    design: ControllerDesign,
    x: FloatArray,
    y: FloatArray,
    kind: Literal["line", "steps"] = "line",
) -> Curve:
    """Return a curve in the look of its design: the recommended one bold, those that were given dashed."""
    best = design.name == study.best
    label = f"{design.name} *" if best else design.name
    return Curve(x, y, index, label, kind, bold=best, dashed=design.source == "given")


def _step_panels(study: Study, shown: Sequence[ControllerDesign]) -> tuple[Panel, Panel]:
    plant = study.loop.plant
    settled = [design.figures.settling_s for design in shown if np.isfinite(design.figures.settling_s)]
    # most of the designs to their end; one slow integral must not squeeze the others
    until = 1.6 * float(np.median(settled)) if settled else float(shown[0].step.time_s[-1]) if shown else 1.0
    until = max(until, 6.0 * study.loop.delay_s)
    outputs, drives = [], []
    for index, design in enumerate(shown):
        inside = design.step.time_s <= until
        time_s = design.step.time_s[inside]
        outputs.append(_curve(study, index, design, time_s, design.step.output[inside]))
        drives.append(_curve(study, index, design, time_s, design.step.drive[inside], "steps"))
    highest = max([1.0, *(float(np.max(curve.y)) for curve in outputs)])
    # the first value of a derivative is a kick that would hide the rest
    values = np.concatenate([design.step.drive[1:] for design in shown]) if shown else np.zeros(1)
    room = 0.12 * float(np.ptp(values) or 1.0)
    level = Curve(np.array([0.0, until]), np.ones(2), "limit", dashed=True)
    upper = Panel(
        (*outputs, level), title="predicted step of the reference", x_range=(0.0, until), height=1.5,
        y_label=f"output, {plant.output_unit}\nper {plant.output_unit}", y_range=(-0.05, 1.08 * highest),
    )  # fmt: skip
    lower = Panel(
        tuple(drives), x_label="time, s", y_label=f"drive, {plant.input_unit}\nper {plant.output_unit}",
        x_range=(0.0, until),
        y_range=(min(0.0, float(np.min(values))) - 0.3 * room, float(np.max(values)) + room),
    )  # fmt: skip
    return upper, lower


def _nyquist(study: Study, shown: Sequence[ControllerDesign]) -> Panel:
    settings, loop = study.settings, study.loop
    angle = np.linspace(0, 2 * np.pi, 361)
    # what the margins that were asked for forbid
    spare = np.radians(settings.phase_margin_deg)
    wedge = np.linspace(np.pi - spare, np.pi + spare, 61)
    curves = [
        Curve(np.cos(angle), np.sin(angle), "limit", dashed=True),
        Curve(np.cos(wedge), np.sin(wedge), "limit", bold=True),
        Curve(np.array([-1.6, -1.0 / settings.gain_margin]), np.zeros(2), "limit", bold=True),
        Curve(np.array([-1.0]), np.zeros(1), "limit", kind="points"),
    ]
    for index, design in enumerate(shown):
        curve = design.gains.frequency_response(loop.grid_rad_s, loop.step_s) * loop.grid_response
        curves.append(_curve(study, index, design, curve.real, curve.imag))
        if design.margins.gain < 1e3:
            curves.append(Curve(np.array([-1.0 / design.margins.gain]), np.zeros(1), index, kind="points"))
    title = (
        f"open loop at {settings.rate_hz:g} Hz; black: margins {settings.gain_margin:g}, "
        f"{settings.phase_margin_deg:g}\N{DEGREE SIGN}"
    )
    return Panel(
        tuple(curves), title=title, x_label="real part of the open loop", y_label="imaginary part",
        x_range=(-1.6, 1.6), y_range=(-1.9, 1.1), equal=True,
    )  # fmt: skip


def _following(study: Study, shown: Sequence[ControllerDesign]) -> tuple[Panel, ...]:
    """Return the reference followed, and its error, on a plant whose gain is below the model's."""
    reference, plant, settings = study.settings.reference, study.loop.plant, study.settings
    if reference is None or not shown:
        return ()
    outputs, errors = [], []
    for index, design in enumerate(shown):
        track = design.follow(reference, settings.range or UNBOUNDED, 1.0 - settings.gain_error)
        outputs.append(_curve(study, index, design, track.time_s, track.output))
        errors.append(_curve(study, index, design, track.time_s, track.reference - track.output))
    wanted = Curve(track.time_s, track.reference, "limit", dashed=True)
    less = f", gain {settings.gain_error:.0%} below the model's" if settings.gain_error else ""
    ends = settings.range
    within = f", drive within {ends[0]:g} ... {ends[1]:g} {plant.input_unit}" if ends else ""
    above = Panel(
        (*outputs, wanted), title=f"reference followed{less}", y_label=f"output, {plant.output_unit}",
    )  # fmt: skip
    below = Panel(
        tuple(errors), title=f"its error{within}", y_label=f"reference less output, {plant.output_unit}", zero=True,
    )  # fmt: skip
    span = (0.0, float(track.time_s[-1]))
    return tuple(replace(panel, x_label="time, s", x_range=span) for panel in (above, below))
