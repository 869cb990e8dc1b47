"""The fit ``tensile``: modulus, yield stress, toe and fracture of every specimen, with intervals over specimens.

How far a hinge may turn before its sheet yields: (3.2) to (3.4) of the source work, as printed and corrected.

Printed: ``F = sigma b t^3 / (6 L)``, ``delta = F x^2 l / (2 E I)``, ``phi = F x l / (E I)``, ``I = b t^3 / 12``. The
first is no force (t^3 for t^2), and the other two are those of a pure moment M = F l, which a force at the end does not
make. With lengths in mm as bare numbers the printed set gives phi = 2 sigma x / E, and for x = 1.75 the published 1.96
degrees, too low by the factor t in mm. That real swings exceed the linear range holds all the same.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, PositiveFloat

from labrun.devices import FloatArray
from labrun.errors import FitError
from labrun.fit import (
    Curve,
    Dataset,
    Estimate,
    FigureData,
    FitJob,
    FitSummary,
    FittedData,
    FitTrial,
    OutputsAlone,
    Panel,
    Stack,
    TextTable,
    WithSettings,
    load_dataset,
    mean_estimate,
)
from labrun.models import Output
from labrun.toml import Keys

_BACKWARDS = 1e-4
"""Strain that a strip may seem to lose on its way out: steps and play of a stage, not a way back."""
_STUCK = 5
"""So many equal readings at the very top are a load cell at the end of its range: its last digit never rests."""
_FALLS = 0.5
"""A fall of force by this share of its greatest, from one moment to the next, is a fracture."""
_FEWEST = 20


@dataclass(frozen=True, slots=True)
class TensileCurve:
    """One test.

    Attributes
    ----------
    young_pa
        Slope of the steepest straight part.
    toe_strain
        Where that straight line meets zero stress: the zero of strain (toe compensation, annex A1 of D882-12).
    yield_pa, yield_strain
        Where the curve departs from the line; strain without the toe. nan if it does not.
    greatest_n
        Force; at fracture, if `broke`.
    """

    young_pa: float
    toe_strain: float
    yield_pa: float
    yield_strain: float
    greatest_n: float
    broke: bool


def tensile_curve(
    force_n: FloatArray,
    displacement_m: FloatArray,
    *,
    area_m2: float,
    grips_m: float,
    window_strain: float = 0.003,
    departs_by_strain: float = 5e-4,
    label: str = "the test",
) -> TensileCurve:
    """Read modulus, toe, yield stress and fracture off force over displacement.

    The modulus is the greatest slope of a straight line through a stretch of `window_strain`. "Yield" is a proportional
    limit: where strain is `departs_by_strain` more than the line's.

    Raises
    ------
    FitError
        Strain that runs backwards, a load cell at the end of its range, or a test too short for a straight part.
    """
    strain, stress = displacement_m / grips_m, force_n / area_m2
    end = int(np.argmax(strain)) + 1
    lost = np.maximum.accumulate(strain[:end]) - strain[:end]
    if lost.max() > _BACKWARDS:
        index = int(np.argmax(lost))
        raise FitError(
            f"the strain of {label} runs backwards: it loses {100 * lost[index]:.2g} % "
            f"at {100 * strain[index]:.3g} %",
            hint="a strip that slips in its grips does that, or a grip that was driven back: mark the trial rejected",
        )
    strain, stress, force = strain[:end], stress[:end], force_n[:end]
    top = int(np.argmax(force))
    if np.count_nonzero(force == force[top]) >= _STUCK:
        raise FitError(
            f"the load cell is at the end of its range in {label}: {force[top]:.4g} N, and no more, "
            f"in {np.count_nonzero(force == force[top])} readings",
            hint="take a larger cell, or a narrower strip",
        )
    broke = bool(end - top > 2 and np.min(force[top : top + 10]) < (1.0 - _FALLS) * force[top])
    strain, stress = strain[: top + 1], stress[: top + 1]
    if len(strain) < _FEWEST or strain[-1] - strain[0] < 2.0 * window_strain:
        raise FitError(
            f"{label} has no straight part of {100 * window_strain:g} % strain: it ends at "
            f"{100 * (strain[-1] - strain[0]):.2g} % after {len(strain)} samples",
            hint="pull it further, or give the fit a smaller window_strain",
        )
    slope, at, level = _steepest(strain, stress, window_strain)
    if not slope > 0:
        raise FitError(f"force does not rise with strain in {label}", hint="are both signs right?")
    toe = at - level / slope
    beyond = (strain - toe) - stress / slope
    departs = np.flatnonzero((beyond >= departs_by_strain) & (strain > at))
    if not len(departs):
        return TensileCurve(slope, toe, np.nan, np.nan, float(force[top]), broke)
    first = int(departs[0])
    share = (departs_by_strain - beyond[first - 1]) / max(beyond[first] - beyond[first - 1], 1e-300)
    share = float(np.clip(share, 0.0, 1.0))
    yields = float(stress[first - 1] + share * (stress[first] - stress[first - 1]))
    yield_strain = float(strain[first - 1] + share * (strain[first] - strain[first - 1])) - toe
    return TensileCurve(slope, toe, yields, yield_strain, float(force[top]), broke)


def _steepest(strain: FloatArray, stress: FloatArray, window: float) -> tuple[float, float, float]:
    """Return slope, middle strain and mean stress of the steepest stretch of least squares."""
    ends = np.searchsorted(strain, strain + window, side="right")
    last = int(np.searchsorted(ends, len(strain)))
    starts = np.arange(max(last, 1))
    ends = np.minimum(ends[starts], len(strain))
    # sums of shifted values: squares of large numbers would cost digits
    x, y = strain - strain.mean(), stress - stress.mean()
    sums = [np.concatenate([[0.0], np.cumsum(series)]) for series in (x, y, x * x, x * y)]
    n = (ends - starts).astype(float)
    sx, sy, sxx, sxy = (series[ends] - series[starts] for series in sums)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = (n * sxy - sx * sy) / (n * sxx - sx * sx)
    slopes[~np.isfinite(slopes) | (n < 3)] = -np.inf
    best = int(np.argmax(slopes))
    return (
        float(slopes[best]),
        float(strain.mean() + sx[best] / n[best]),
        float(stress.mean() + sy[best] / n[best]),
    )


def printed_deg(yield_pa: float, young_pa: float, x_mm: float) -> float:
    """Return the angle as the printed equations give it, deg; `x_mm` is taken as a bare number, as the source did."""
    return math.degrees(2.0 * yield_pa * x_mm / young_pa)


def allowable_deg(
    yield_pa: float,
    young_pa: float,
    length_m: float,
    thickness_m: float,
    load: Literal["moment", "end force"] = "moment",
) -> float:
    """Return the angle at which the outer fibre of a hinge yields, deg.

    ``2 sigma l / (E t)`` where the same moment bends all of it; half of that where a force at its end does, which
    strains the clamped end most.
    """
    bent_all_along = math.degrees(2.0 * yield_pa * length_m / (young_pa * thickness_m))
    return bent_all_along if load == "moment" else 0.5 * bent_all_along


SPECIMEN = "specimen"
NEAR_GRIP_MM = 5.0
"""A break this near a grip is the grip's (D882-12 lets it count only if it fits the others)."""
_QUANTITIES: tuple[tuple[str, str, Callable[[TensileCurve], float]], ...] = (
    ("young", "MPa", lambda curve: 1e-6 * curve.young_pa),
    ("yield_stress", "MPa", lambda curve: 1e-6 * curve.yield_pa),
    ("yield_strain", "%", lambda curve: 100.0 * curve.yield_strain),
    ("toe_strain", "%", lambda curve: 100.0 * curve.toe_strain),
    ("fracture_load", "N", lambda curve: curve.greatest_n if curve.broke else math.nan),
)


class TensileSettings(Keys):
    """Keys of ``[fit.settings]``.

    Attributes
    ----------
    thickness_mm, width_mm, grips_mm
        Of the strip, and from grip to grip.
    window_strain
        Length of the straight part whose slope is the modulus.
    departs_by_strain
        The curve yields where it is this far from the line; the source does not say how it read its yield stress.
    hinge_length_mm
        Of a hinge of this sheet, whose allowable angle is told.
    """

    thickness_mm: PositiveFloat = 0.127
    width_mm: PositiveFloat = 15.0
    grips_mm: PositiveFloat = 100.0
    window_strain: PositiveFloat = 0.003
    departs_by_strain: PositiveFloat = 5e-4
    hinge_length_mm: PositiveFloat = 1.75


_MEASURED = OutputsAlone((Output("force", "N"), Output("displacement", "m")))


class TensileFit(WithSettings[TensileSettings]):
    """Each test by itself; estimates are means over specimens with t-intervals."""

    Settings: ClassVar[type[BaseModel]] = TensileSettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit. Raises FitError: no test can be read: strain that runs backwards, a load cell beyond its range."""
        data = load_dataset(job.target, _MEASURED, job.signals)
        keys = self._settings
        area_m2 = 1e-6 * keys.thickness_mm * keys.width_mm
        read: list[tuple[FitTrial, TensileCurve]] = []
        refused: list[FitError] = []
        for trial in data.trials:
            try:
                curve = tensile_curve(
                    trial.outputs[:, 0],
                    trial.outputs[:, 1],
                    area_m2=area_m2,
                    grips_m=1e-3 * keys.grips_mm,
                    window_strain=keys.window_strain,
                    departs_by_strain=keys.departs_by_strain,
                    label=trial.label,
                )
            except FitError as error:
                refused.append(error)
            else:
                read.append((trial, curve))
        if not read:
            raise refused[0]
        groups = _grouped(read)
        parameters: dict[str, Estimate] = {}
        for group, specimens in groups.items():
            for name, unit, of in _QUANTITIES:
                estimate = _estimate([[of(curve) for curve in curves] for curves in specimens.values()], unit)
                if estimate is not None:
                    parameters[f"{name}_{group}" if group else name] = estimate
        warnings = [f"left out: {error.args[0]}" for error in refused]
        warnings += _near_grips(read)
        warnings += [
            f"{group or 'the sheet'}: one specimen only, and no interval"
            for group, specimens in groups.items()
            if len(specimens) == 1
        ]
        return FitSummary(
            method="tensile",
            model_name="tensile",
            data=FittedData(data.name, data.kind, len(read), data.left_out + len(refused)),
            parameters=parameters,
            fixed={"thickness_mm": keys.thickness_mm, "width_mm": keys.width_mm, "grips_mm": keys.grips_mm},
            tables=(_table(groups),),
            findings=(*_findings(groups, parameters), *_allowable(parameters, keys)),
            warnings=tuple(warnings),
            details={"by_specimen": _details(groups)},
            figure_data=lambda: _figure(data, read, keys, area_m2),
        )


Groups = Mapping[str, Mapping[str, Sequence[TensileCurve]]]


def _grouped(read: Sequence[tuple[FitTrial, TensileCurve]]) -> Groups:
    """Return tests by what else than the specimen their conditions say, and by specimen."""
    others = sorted({name for trial, _ in read for name in trial.condition} - {SPECIMEN, "break_at_mm"})
    groups: dict[str, dict[str, list[TensileCurve]]] = {}
    for number, (trial, curve) in enumerate(read):
        group = "_".join(_word(trial.condition[name]) for name in others if name in trial.condition)
        specimen = _word(trial.condition.get(SPECIMEN, f"test {number + 1}"))
        groups.setdefault(group, {}).setdefault(specimen, []).append(curve)
    return groups


def _word(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _estimate(by_specimen: Sequence[Sequence[float]], unit: str) -> Estimate | None:
    """Return the mean over specimens, each the mean of its tests, with a t-interval; None if none has a value."""
    means = [float(np.mean(own)) for own in by_specimen if np.all(np.isfinite(own))]
    return mean_estimate(means, unit) if means else None


def _table(groups: Groups) -> TextTable:
    header = (SPECIMEN, *(f"{name}, {unit}" for name, unit, _ in _QUANTITIES))
    rows = []
    for group, specimens in groups.items():
        for specimen, curves in specimens.items():
            values = (float(np.mean([of(curve) for curve in curves])) for _, _, of in _QUANTITIES)
            cells = ("" if math.isnan(value) else f"{value:.4g}" for value in values)
            rows.append((f"{group} {specimen}".strip(), *cells))
    return TextTable("by specimen", header, tuple(rows))


def _details(groups: Groups) -> list[dict[str, Any]]:
    return [
        {"group": group, SPECIMEN: specimen}
        | {
            name: float(np.mean([of(curve) for curve in curves]))
            for name, _, of in _QUANTITIES
            if math.isfinite(np.mean([of(curve) for curve in curves]))
        }
        for group, specimens in groups.items()
        for specimen, curves in specimens.items()
    ]


def _findings(groups: Groups, parameters: Mapping[str, Estimate]) -> list[str]:
    if len(groups) != 2 or "" in groups:
        return []
    first_group, other = groups
    lines = []
    for name, what in (("young", "initial slopes"), ("fracture_load", "fracture loads")):
        first, second = parameters.get(f"{name}_{first_group}"), parameters.get(f"{name}_{other}")
        if first is None or second is None:
            continue
        apart = first.ci95[1] < second.ci95[0] or second.ci95[1] < first.ci95[0]
        ratio = second.value / first.value
        lines.append(
            f"{what}: {other} has {ratio:.2f} times that of {first_group}"
            + ("" if apart else ", which their intervals do not tell apart")
        )
    return lines


def _allowable(parameters: Mapping[str, Estimate], keys: TensileSettings) -> list[str]:
    """Say how far a hinge of the sheet may turn."""
    young, yields = parameters.get("young"), parameters.get("yield_stress")
    if young is None or yields is None:
        return []
    stated = 1e6 * yields.value, 1e6 * young.value
    size = 1e-3 * keys.hinge_length_mm, 1e-3 * keys.thickness_mm
    moment, end_force = (allowable_deg(*stated, *size, load) for load in ("moment", "end force"))
    printed = printed_deg(*stated, keys.hinge_length_mm)
    return [
        f"a hinge {keys.hinge_length_mm:g} mm long yields at {moment:.1f} deg where a moment bends it, at "
        f"{end_force:.1f} deg where a force at its end does; (3.2) to (3.4) as printed say {printed:.2f} deg, too low "
        "by the factor t in mm"
    ]


def _near_grips(read: Sequence[tuple[FitTrial, TensileCurve]]) -> list[str]:
    near = [
        trial.label
        for trial, curve in read
        if curve.broke
        and isinstance(at := trial.condition.get("break_at_mm"), int | float)
        and at < NEAR_GRIP_MM
    ]
    if not near:
        return []
    return [f"broken within {NEAR_GRIP_MM:g} mm of a grip, which the grip may have caused: {'; '.join(near)}"]


def _figure(
    data: Dataset, read: Sequence[tuple[FitTrial, TensileCurve]], keys: TensileSettings, area_m2: float
) -> FigureData:
    """Return stress over strain without the toe of every test, the mean line and the yield points."""
    curves, yields = [], []
    for number, (trial, curve) in enumerate(read):
        step = max(len(trial.time_s) // 2000, 1)
        strain = 1e3 * trial.outputs[::step, 1] / keys.grips_mm - curve.toe_strain
        stress = 1e-6 * trial.outputs[::step, 0] / area_m2
        curves.append(Curve(100 * strain, stress, "measured", "measured" if number == 0 else ""))
        if math.isfinite(curve.yield_pa):
            yields.append((100 * curve.yield_strain, 1e-6 * curve.yield_pa))
    young = 1e-6 * float(np.mean([curve.young_pa for _, curve in read]))
    top = max((stress for _, stress in yields), default=max(float(np.max(curve.y)) for curve in curves))
    line = np.array([0.0, 1.1 * top])
    curves.append(Curve(100 * line / young, line, "fitted", f"{young:.0f} MPa"))
    if yields:
        at, stress = np.array(yields).T
        curves.append(Curve(at, stress, "point", "yield", kind="points"))
    panel = Panel(tuple(curves), x_label="strain without the toe, %", y_label="stress, MPa", zero=True)
    title = f"Tensile tests of {data.name}\nEach shifted by its toe strain"
    return FigureData(title, ((Stack((panel,), width=1.6),),), row_height_in=3.8)
