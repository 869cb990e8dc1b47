"""The designs as tables of text."""

import math

from labrun.fit.summary import TextTable
from labrun.fit.tuning.design import Design
from labrun.fit.tuning.study import Study
from labrun.fit.tuning.words import drive_per_output, with_unit


def tables(study: Study) -> tuple[TextTable, ...]:
    """Return gains, margins, predicted step, and, where there is a reference, errors."""
    found = [_gains(study), _margins(study), _step(study)]
    if study.errors:
        found.append(_tracking(study))
    return tuple(found)


def _gains(study: Study) -> TextTable:
    unit, rate = drive_per_output(study), study.settings.rate_hz
    rows = []
    for one in study.designs:
        gains = one.gains
        rows.append(
            (
                _name(one, study),
                one.structure,
                _number(gains.p),
                _number(gains.i_per_s),
                _number(gains.i_per_sample(rate)),
                _number(gains.d_s),
                _number(gains.filter_s) if gains.d_s else "-",
                "-" if gains.feedforward is None else _number(gains.feedforward),
            )
        )
    header = ("", "structure", "P", "I per s", f"I per sample ({rate:g} Hz)", "D s", "filter s", "FF")
    return TextTable(with_unit("gains", unit, ", "), header, tuple(rows))


def _margins(study: Study) -> TextTable:
    rows = []
    for one in study.designs:
        found = one.margins
        spread = study.spreads.get(one.name)
        rows.append(
            (
                _name(one, study),
                _margin(found.gain),
                "-" if spread is None else _interval(spread.gain, 2),
                _margin(found.phase_deg),
                "-" if spread is None else _interval(spread.phase_deg, 0),
                _margin(found.delay_s),
                _number(found.sensitivity),
                _number(found.crossover_rad_s) if found.crossover_rad_s else "none",
                "yes" if found.stable else "NO",
            )
        )
    return TextTable(
        "margins of the loop as it runs (95 %: over the fit's own uncertainty; none: nothing to lose, no crossing)",
        (
            "",
            "gain",
            "95 %",
            "phase, deg",
            "95 %",
            "delay, s",
            "Ms",
            "crossover, rad/s",
            "stable",
        ),
        tuple(rows),
    )


def _step(study: Study) -> TextTable:
    unit = drive_per_output(study)
    rows = []
    for one in study.designs:
        if not one.margins.stable:
            continue
        figures = one.figures
        rows.append(
            (
                _name(one, study),
                f"{100 * figures.overshoot:.1f} %",
                _number(figures.settling_s),
                f"{100 * figures.steady_error:.1f} %",
                _number(figures.peak_drive),
                _number(one.noise_gain),
            )
        )
    return TextTable(
        "predicted step of the reference, drive without bounds",
        (
            "",
            "overshoot",
            "settles (2 %), s",
            "stays off by",
            with_unit("peak drive", unit, ", "),
            with_unit("drive noise", unit, ", "),
        ),
        tuple(rows),
    )


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


def _name(design: Design, study: Study) -> str:
    return f"{design.name} *" if design.name == study.best else design.name


def _number(value: float) -> str:
    if math.isinf(value):
        return "inf"
    return "0" if value == 0 else f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"


def _margin(value: float) -> str:
    return "none" if math.isinf(value) else _number(value)


def _interval(ends: tuple[float, float], decimals: int) -> str:
    if all(math.isinf(end) for end in ends):
        return ""  # the margin beside it says none
    low, high = ("none" if math.isinf(end) else f"{end:.{decimals}f}" for end in ends)
    return f"{low} ... {high}"
