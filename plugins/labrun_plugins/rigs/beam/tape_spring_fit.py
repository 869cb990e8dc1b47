"""The fit ``tape-spring``: measured limits of beams beside (7.1) to (7.8), and which width the theory holds with.

Tape springs: torque over longitudinal curvature, and the limits at which they buckle, equations (7.1) to (7.8).

Corrected where the print needs it: (7.4) has lost its brackets, (7.6) takes the magnitude of the curvature, (7.8) is
(1 - nu) D theta, which is what (7.1) itself gives at a longitudinal curvature of -1/r and no width. Torques carry the
name of their sense, never a sign: bent against its curvature (opposite sense) the strip snaps at the maximum of (7.1);
bent with it (equal sense) it buckles at (7.8), and what (7.1) says beyond is cut off there: the twist that lets it
buckle early is not in (7.1).

Names of the literature for this theory: Wuest; Mansfield; Seffen and Pellegrino; Soykasap.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field, PositiveFloat

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
from labrun_plugins.rigs.beam.limits import BucklingLimit, buckling_limit

Width = Literal["arc", "chord"]
POLYESTER_PA = 4.383e9
"""Young's modulus of polyester, section 3.1."""
_MOST_TURNS = 30.0
"""Longitudinal curvatures up to this many times 1/r are searched for the maximum; it lies below 1/r."""


@dataclass(frozen=True, slots=True)
class TapeSpring:
    """A straight strip with a curved cross-section.

    Attributes
    ----------
    arc_m
        Length of the cross-section along its curve, r theta.
    theta_rad
        Angle of the cross-section's arc.
    thickness_m, young_pa, poisson
        Of the sheet.
    width
        What stands for s in (7.1): the arc, r theta, or the chord, 2 r sin(theta/2), as (7.2) has it.
    """

    thickness_m: float
    arc_m: float = 25.4e-3
    theta_rad: float = math.pi
    young_pa: float = POLYESTER_PA
    poisson: float = 0.35
    width: Width = "arc"

    @property
    def radius_m(self) -> float:
        """Transverse radius r, m."""
        return self.arc_m / self.theta_rad

    @property
    def width_m(self) -> float:
        """The s of (7.1), m."""
        return self.arc_m if self.width == "arc" else 2.0 * self.radius_m * math.sin(0.5 * self.theta_rad)

    @property
    def rigidity_n_m(self) -> float:
        """Bending stiffness D of the sheet, N m, (7.3)."""
        return self.young_pa * self.thickness_m**3 / (12.0 * (1.0 - self.poisson**2))

    @property
    def equal_limit_n_m(self) -> float:
        """Torque at which it buckles in equal sense, N m, (7.8) corrected."""
        return (1.0 - self.poisson) * self.rigidity_n_m * self.theta_rad

    @property
    def opposite_limit_n_m(self) -> float:
        """Torque at which it snaps in opposite sense, N m: the first maximum of (7.1); nan where it has none."""
        return self.torque_n_m(self.opposite_curvature_per_m)

    @property
    def opposite_curvature_per_m(self) -> float:
        """Longitudinal curvature at that maximum, 1/m; nan where there is none."""
        curvature = np.geomspace(1e-4, _MOST_TURNS, 4000) / self.radius_m
        torque = np.array([self.torque_n_m(float(value)) for value in curvature])
        falls = np.flatnonzero(np.diff(torque) < 0)
        if not len(falls):
            return math.nan
        from scipy.optimize import minimize_scalar

        top = int(falls[0])
        low, high = float(curvature[max(top - 1, 0)]), float(curvature[top + 1])
        solution = minimize_scalar(
            lambda angle: -self.torque_n_m(angle), bounds=(low, high), method="bounded"
        )
        return float(solution.x)

    def torque_n_m(self, curvature_per_m: float) -> float:
        """Return the torque at a longitudinal curvature (1/m, positive in opposite sense), N m, (7.1)."""
        if not curvature_per_m:
            return 0.0
        curved, nu, k = 1.0 / self.radius_m, self.poisson, curvature_per_m
        size = (3.0 * (1.0 - nu**2)) ** 0.25 * self.width_m / math.sqrt(self.thickness_m / abs(k))
        first, second = shape_functions(size)
        bracket = k + nu * curved - nu * (curved + nu * k) * first + (curved + nu * k) ** 2 * second / k
        return float(self.width_m * self.rigidity_n_m * bracket)


def shape_functions(size: float) -> tuple[float, float]:
    """Return F1 (7.4), its brackets put back, and F2 (7.5) of the dimensionless width (7.6).

    For a narrow strip F1 goes to 1 - size^4/180 and F2 to size^4/180; the closed forms lose all digits there.
    """
    if size < 0.3:
        return 1.0 - size**4 / 180.0, size**4 / 180.0
    # divided by cosh, which overflows for wide strips
    tanh, cosine, sine = math.tanh(size), math.cos(size), math.sin(size)
    over = 1.0 / math.cosh(size) if size < 700.0 else 0.0
    first = 2.0 / size * (1.0 - cosine * over) / (tanh + sine * over)
    return first, 0.25 * first - tanh * sine * over / (tanh + sine * over) ** 2


_SENSES = ("equal", "opposite")


class TapeSpringSettings(Keys):
    """Keys of ``[fit.settings]``.

    Attributes
    ----------
    beam
        Which of the conditions ``beam`` the theory is held against: a long one, since it knows no clamped ends.
    lever_mm
        From the beam's clamp to the pusher.
    arc_mm, theta_deg
        Of the cross-section: its length along the curve, and its angle.
    young_gpa, poisson
        Of the sheet; Poisson's ratio is not in the source (0.35 for polyester).
    """

    beam: str = "long"
    lever_mm: PositiveFloat = 100.0
    arc_mm: PositiveFloat = 25.4
    theta_deg: float = Field(default=180.0, gt=0.0, le=360.0)
    young_gpa: PositiveFloat = 4.383
    poisson: float = Field(default=0.35, ge=0.0, lt=0.5)


_MEASURED = OutputsAlone((Output("force", "N"), Output("displacement", "m")))


@dataclass(frozen=True)
class _Measured:
    """Limits of one beam in one sense, one a trial that buckled."""

    beam: str
    sense: str
    values: FloatArray
    survived: int

    @property
    def estimate(self) -> Estimate | None:
        return mean_estimate(self.values, "N m") if len(self.values) else None


class TapeSpringFit(WithSettings[TapeSpringSettings]):
    """Equal limit gives the sheet's effective thickness; with it the theory says what the opposite limit must be."""

    Settings: ClassVar[type[BaseModel]] = TapeSpringSettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit. Raises FitError: no trial of the beam buckled in equal sense."""
        keys = self._settings
        data = load_dataset(job.target, _MEASURED, job.signals)
        limits = [
            buckling_limit(trial.outputs[:, 0], trial.outputs[:, 1], 1e-3 * keys.lever_mm)
            for trial in data.trials
        ]
        measured = _grouped(data, limits)
        equal, opposite = (
            next((group for group in measured if (group.beam, group.sense) == (keys.beam, sense)), None)
            for sense in _SENSES
        )
        limit = None if equal is None else equal.estimate
        if limit is None:
            beams = ", ".join(sorted({group.beam for group in measured}))
            raise FitError(
                f"no trial of the beam {keys.beam!r} buckled in equal sense, which the sheet's thickness follows from",
                hint=f"measured were {beams}: name one with --set beam=NAME, or bend it further",
            )
        arc, chord = (self._strip(limit.value, width) for width in ("arc", "chord"))
        low, high = (self._strip(end, "arc") for end in limit.ci95)
        mm = Estimate(1e3 * arc.thickness_m, (1e3 * low.thickness_m, 1e3 * high.thickness_m), "mm")
        parameters = {"equal_limit": limit, "effective_thickness": mm}
        snapped = None if opposite is None else opposite.estimate
        if snapped is not None:
            parameters["opposite_limit"] = snapped
        for name, strip in (("arc", arc), ("chord", chord)):
            ends = tuple(self._strip(end, name).opposite_limit_n_m for end in limit.ci95)
            parameters[f"opposite_by_{name}"] = Estimate(strip.opposite_limit_n_m, (ends[0], ends[1]), "N m")
        return FitSummary(
            method="tape-spring",
            model_name="tape spring",
            data=FittedData.of(data),
            parameters=parameters,
            fixed={"young_gpa": keys.young_gpa, "poisson": keys.poisson, "arc_mm": keys.arc_mm},
            tables=(_table(measured),),
            findings=tuple(_findings(arc, chord, snapped)),
            warnings=tuple(_warnings(measured)),
            figure_data=lambda: _figure(data, limits, keys, arc, chord),
        )

    def _strip(self, limit_n_m: float, width: str) -> TapeSpring:
        keys = self._settings
        unit = TapeSpring(
            1.0, 1e-3 * keys.arc_mm, math.radians(keys.theta_deg), 1e9 * keys.young_gpa, keys.poisson
        )
        thickness = (max(limit_n_m, 1e-12) / unit.equal_limit_n_m) ** (1.0 / 3.0)
        return replace(unit, thickness_m=thickness, width="arc" if width == "arc" else "chord")


def _grouped(data: Dataset, results: list[BucklingLimit]) -> list[_Measured]:
    groups: dict[tuple[str, str], list[BucklingLimit]] = {}
    for trial, limit in zip(data.trials, results, strict=True):
        groups.setdefault((str(trial.condition.get("beam", "long")), limit.sense), []).append(limit)
    return [
        _Measured(
            beam,
            sense,
            np.array([limit.torque_n_m for limit in limits if limit.reached]),
            sum(not limit.reached for limit in limits),
        )
        for (beam, sense), limits in sorted(groups.items())
    ]


def _table(measured: list[_Measured]) -> TextTable:
    rows = []
    for group in measured:
        estimate = group.estimate
        estimate_cells = ("none", "") if estimate is None else (f"{estimate.value:.4g}", _half(estimate))
        rows.append((group.beam, group.sense, str(len(group.values)), *estimate_cells))
    return TextTable("limits as measured, N m", ("beam", "sense", "trials", "mean", "95 %"), tuple(rows))


def _half(estimate: Estimate) -> str:
    return (
        f"+- {0.5 * (estimate.ci95[1] - estimate.ci95[0]):.2g}" if estimate.ci95[0] < estimate.ci95[1] else ""
    )


def _findings(arc: TapeSpring, chord: TapeSpring, snapped: Estimate | None) -> list[str]:
    notes = [
        f"{1e3 * arc.thickness_m:.3g} mm is the thickness of a single sheet of the stated modulus that buckles in "
        "equal sense where the beam does, (1 - nu) D theta; a laminate is thinner and of several materials"
    ]
    if snapped is None:
        return [*notes, "no trial snapped in opposite sense: which width holds is not known"]
    off = {
        name: strip.opposite_limit_n_m / snapped.value - 1.0
        for name, strip in (("arc", arc), ("chord", chord))
    }
    holds = min(off, key=lambda name: abs(off[name]))
    means = {"arc": "the arc, r theta", "chord": "the chord, 2 r sin(theta/2)"}
    words = [
        f"with {means[name]}, {strip.opposite_limit_n_m:.3g} N m ({100 * off[name]:+.0f} %)"
        for name, strip in (("arc", arc), ("chord", chord))
    ]
    return [
        *notes,
        f"in opposite sense (7.1) then says {'; '.join(words)}; measured is {snapped.value:.3g} N m",
        f"{means[holds]}, holds as the width of (7.1)",
    ]


def _warnings(measured: list[_Measured]) -> list[str]:
    alone = [f"{group.beam} in {group.sense} sense" for group in measured if len(group.values) == 1]
    notes = [f"one trial only of {', '.join(alone)}: no interval is known"] if alone else []
    return notes + [
        f"{group.survived} of {group.survived + len(group.values)} trials of the beam {group.beam} did not buckle in "
        f"{group.sense} sense: its limit is above what they bore"
        for group in measured
        if group.survived
    ]


def _figure(
    data: Dataset, limits: list[BucklingLimit], keys: TapeSpringSettings, arc: TapeSpring, chord: TapeSpring
) -> FigureData:
    """Return torque over angle of a trial of each beam and sense, theory beside that which it is about."""
    lever_m = 1e-3 * keys.lever_mm
    stacks: dict[str, list[Curve]] = {}
    seen = set()
    for trial, limit in zip(data.trials, limits, strict=True):
        beam = str(trial.condition.get("beam", "long"))
        if (beam, limit.sense) in seen:
            continue
        seen.add((beam, limit.sense))
        step = max(len(trial.time_s) // 4000, 1)
        force, way = trial.outputs[::step, 0], trial.outputs[::step, 1]
        label = "measured" if beam not in stacks else ""
        stacks.setdefault(beam, []).append(
            Curve(np.degrees(way / lever_m), lever_m * force, "measured", label, bold=False)
        )
    for beam, curves in stacks.items():
        if beam != keys.beam:
            continue
        ends = np.array([min(np.min(curve.x) for curve in curves), max(np.max(curve.x) for curve in curves)])
        for number, (name, level) in enumerate(
            (
                ("equal, (7.8)", -arc.equal_limit_n_m),
                ("opposite, arc", arc.opposite_limit_n_m),
                ("opposite, chord", chord.opposite_limit_n_m),
            )
        ):
            curves.append(Curve(ends, np.full(2, level), number, f"{beam}, theory: {name}", dashed=True))
    panels = [
        Stack((Panel(tuple(curves), beam, x_label="angle, deg", y_label="torque, N m", zero=True),))
        for beam, curves in stacks.items()
    ]
    rows = tuple(tuple(panels[start : start + 2]) for start in range(0, len(panels), 2))
    title = f"Tape spring beside {data.name}\nPositive is the opposite sense"
    return FigureData(title, rows, legend="top")
