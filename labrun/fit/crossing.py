"""The fit ``crossing``: where two fitted curves cross, or one reaches a level, with an interval from resampled trials.

Each curve is an objective of a run over one of its conditions: thrust over speed, drag over speed, torque over angle. A
curve may come from another run (``--with``), so that what two experiments found makes one result. Trials are what is
independent: each resample draws whole trials anew at every place of both curves, fits both, and crosses them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, Field

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.estimate import Estimate
from labrun.experiment import condition_text
from labrun.fit.method import FitJob, WithSettings
from labrun.fit.result import Curve, FigureData, FitSummary, FittedData, Panel, Stack, TextTable
from labrun.store import Run, TrialOutcome, is_recording, open_run
from labrun.toml import Keys, suggest

_RESAMPLES = 2000
_GRID = 401
_OPEN_SHARE = 0.025
"""If more of the resamples than that do not cross, the interval has no end on that side."""


class CurveTable(Keys):
    """Keys of ``[fit.settings.one]`` and ``[fit.settings.other]``.

    Attributes
    ----------
    objective
        What is fitted.
    experiment
        Whose run it is in, where that is not the run that is fitted: give that run with ``--with``.
    where
        Conditions that hold for the trials that are meant.
    powers
        Of the condition, one a term: [0, 1, 2] is a parabola, [2] a drag that goes with the square of speed.
    scale
        The objective is multiplied by it first, to turn it round (-1).
    """

    objective: str
    experiment: str | None = None
    where: dict[str, float | str] = Field(default_factory=dict)
    powers: Annotated[tuple[float, ...], Field(min_length=1)] = (0, 1, 2)
    scale: float = 1.0


class CrossingSettings(Keys):
    """Keys of ``[fit.settings]``.

    Attributes
    ----------
    over
        The condition along which the curves go.
    one, other
        The curves; without `other`, where the first one reaches `level`.
    level
        See `other`.
    by
        A condition whose levels have a crossing each; and what to call these.
    names
        Level -> name.
    gain_at
        Where along `over` the levels' first curves are compared as well.
    """

    over: str
    one: CurveTable
    other: CurveTable | None = None
    level: float = 0.0
    by: str | None = None
    names: dict[str, str] = Field(default_factory=dict)
    gain_at: float | None = None


@dataclass(frozen=True, slots=True)
class Measured:
    """One curve: place along the condition and value of each trial, shape (n,)."""

    x: FloatArray
    y: FloatArray
    powers: tuple[float, ...] = (0, 1, 2)

    def terms(self, x: FloatArray) -> FloatArray:
        """Return the terms at some places, shape (m, powers)."""
        return np.asarray(np.power(x[:, None], np.array(self.powers)))

    def coefficients(self, y: FloatArray) -> FloatArray:
        """Return the least-squares coefficients of values at the curve's places, y of shape (..., n)."""
        return np.asarray(y @ np.linalg.pinv(self.terms(self.x)).T)

    def resampled(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Draw whole trials anew at each place, shape (count, n).

        Deviations from a place's mean are stretched by sqrt(n / (n - 1)) for its n trials, as a plain bootstrap of few
        is too narrow by that. Where places have one trial each, what resamples is how trials lie about the curve
        (residuals, stretched for the fitted coefficients).
        """
        drawn = np.empty((count, len(self.y)))
        places = [np.flatnonzero(self.x == x) for x in np.unique(self.x)]
        if min(map(len, places)) > 1:
            for own in places:
                values, n = self.y[own], len(own)
                mean, stretch = values.mean(), np.sqrt(n / (n - 1))
                drawn[:, own] = mean + stretch * (values[rng.integers(n, size=(count, n))] - mean)
            return drawn
        fitted = self.terms(self.x) @ self.coefficients(self.y)
        n, freedom = len(self.y), max(len(self.y) - len(self.powers), 1)
        rest = (self.y - fitted) * np.sqrt(n / freedom)
        return np.asarray(fitted + rest[rng.integers(n, size=(count, n))])

    def drawn(self, rng: np.random.Generator, count: int = _RESAMPLES) -> FloatArray:
        """Return the values as measured, and those of every resample below, shape (count + 1, n)."""
        return np.vstack([self.y, self.resampled(rng, count)])


@dataclass(frozen=True, slots=True)
class Crossing:
    """Where two curves cross.

    Attributes
    ----------
    at
        The least place at which they do.
    ci95
        95 % percentile interval over resampled trials; where these do not cross, an end stands at the end of what was
        measured.
    value
        What both are there.
    open
        Share of the resamples that do not cross where there are data.
    """

    at: float
    ci95: tuple[float, float]
    value: float
    open: float


def crossing(
    measured: Measured, other: Measured | float, rng: np.random.Generator, resamples: int = _RESAMPLES
) -> Crossing | None:
    """Return where two fitted curves, or a curve and a level, cross; None if not where both were measured."""
    places = [measured.x] if isinstance(other, float) else [measured.x, other.x]
    grid = np.linspace(max(x.min() for x in places), min(x.max() for x in places), _GRID)
    if not grid[0] < grid[-1]:
        return None
    course = measured.coefficients(measured.drawn(rng, resamples)) @ measured.terms(grid).T
    difference = (
        course - other
        if isinstance(other, float)
        else course - other.coefficients(other.drawn(rng, resamples)) @ other.terms(grid).T
    )
    at = _first_zero(grid, difference)
    if np.isnan(at[0]):
        return None
    # Those that do not cross: they would beyond the end towards which they come closer.
    never = np.isnan(at)
    nearer_end = np.abs(difference[never, -1]) < np.abs(difference[never, 0])
    at[never] = np.where(nearer_end, grid[-1], grid[0])
    low, high = np.percentile(at[1:], [2.5, 97.5])
    value = other if isinstance(other, float) else float(np.interp(at[0], grid, course[0]))
    return Crossing(float(at[0]), (float(low), float(high)), value, float(never[1:].mean()))


def _first_zero(grid: FloatArray, difference: FloatArray) -> FloatArray:
    """Return the first place where each row changes its sign, straight between points; NaN where it does not."""
    signs = np.sign(difference)
    changes = signs[:, 1:] * signs[:, :-1] <= 0
    resampled = changes.any(axis=1)
    left = np.argmax(changes, axis=1)
    rows = np.arange(len(difference))
    before, after = difference[rows, left], difference[rows, left + 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(before == after, 0.0, before / (before - after))
    return np.where(resampled, grid[left] + share * (grid[left + 1] - grid[left]), np.nan)


class CrossingFit(WithSettings[CrossingSettings]):
    """Where two curves cross, of every level of a factor."""

    Settings: ClassVar[type[BaseModel]] = CrossingSettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit.

        Raises
        ------
        RequestError
            A recording, an objective or a condition that is not there, or a run that was not given.
        FitError
            Too few places for a curve, or curves that do not cross where they were measured.
        """
        keys, runs = self._settings, _read(job)
        target = next(iter(runs))
        run = _run_of(runs, keys.one, target)
        other = None if keys.other is None else _run_of(runs, keys.other, target)
        parameters: dict[str, Estimate] = {}
        findings, warnings, rows = list[str](), list[str](), list[tuple[str, ...]]()
        curves, crossings, measured = list[Curve](), list[Curve](), dict[str, Measured]()
        x_unit, y_unit = run.units().get(keys.over, ""), run.units().get(keys.one.objective, "")
        against = f"{keys.level:g} {y_unit}".rstrip() if keys.other is None else keys.other.objective
        for level in _levels(_counted(run), keys.by):
            name = _name(level, keys.names)
            first = measured[name] = _curve(run, keys, keys.one, level)
            second: Measured | float = keys.level
            if other is not None and keys.other is not None:
                # Another run need not know the factor: its curve then is that of all levels.
                known = any(keys.by in trial.condition for trial in _counted(other)) if keys.by else False
                second = _curve(other, keys, keys.other, level if known else None)
            prefix = f"{name}: " if name else ""
            intersection = crossing(first, second, job.rng)
            if intersection is None:
                raise FitError(
                    f"{prefix}{keys.one.objective}, {first.y.min():.3g} to {first.y.max():.3g}, does not meet "
                    f"{keys.other.objective if keys.other else f'{keys.level:g}'} where both were measured",
                    hint=f"measure farther: {keys.over} went from {first.x.min():g} to {first.x.max():g} "
                    f"{x_unit}".rstrip(),
                )
            low, high = intersection.ci95
            parameters[f"at_{name.replace(' ', '_')}" if name else "at"] = Estimate(
                intersection.at, intersection.ci95, x_unit
            )
            findings.append(
                f"{prefix}{keys.one.objective} meets {against} at {keys.over} = {intersection.at:.4g} {x_unit} "
                f"({low:.4g} to {high:.4g})"
            )
            if intersection.open > _OPEN_SHARE:
                warnings.append(
                    f"{prefix}{100 * intersection.open:.0f} % of the resamples do not cross where there are data: "
                    "the interval "
                    f"is open at an end; measure farther along {keys.over}"
                )
            rows.append(
                (name or "all", f"{len(first.y)}", f"{intersection.at:.4g}", f"{intersection.value:.4g}")
            )
            ends = np.clip(
                intersection.ci95, first.x.min(), first.x.max()
            )  # of an open one, as far as was measured
            crossings.append(Curve(ends, np.full(2, intersection.value), len(curves) // 2, bold=True))
            curves += _drawn(first, name or keys.one.objective, len(curves) // 2)
            if isinstance(second, Measured) and keys.other is not None:
                curves += _drawn(second, f"{name} {keys.other.objective}".strip(), len(curves) // 2)
        if keys.gain_at is not None and len(measured) > 1:
            findings += _gains(measured, keys.gain_at, x_unit, keys.one.objective, job.rng)
        if any(trial.truncation.get(keys.one.objective) for trial in _counted(run)):
            warnings.append("what cycles cut by the window may do to each value is not in these intervals")
        used = sum(len(curve.y) for curve in measured.values())
        x_label, y_label = (
            f"{name}, {unit}".rstrip(", ")
            for name, unit in ((keys.over, x_unit), (keys.one.objective, y_unit))
        )
        header = (keys.by or "", "trials", x_label, f"value, {y_unit}".rstrip(", "))
        zero = keys.other is None and keys.level == 0.0
        panel = Panel((*curves, *crossings), x_label=x_label, y_label=y_label, zero=zero)
        title = f"Where curves of {run.name} cross\nbold: 95 % interval of each crossing"
        figure = FigureData(title, ((Stack((panel,), width=1.6),),), row_height_in=3.8)
        return FitSummary(
            method="crossing",
            model_name="crossing",
            data=FittedData(run.name, "run", used, len(_counted(run)) - used),
            parameters=parameters,
            tables=(TextTable("where the curves cross", header, tuple(rows)),) if len(rows) > 1 else (),
            findings=tuple(findings),
            warnings=tuple(warnings),
            figure_data=lambda: figure,
        )


def _read(job: FitJob) -> dict[str, Run]:
    runs: dict[str, Run] = {}
    for path in (job.target, *job.more):
        if is_recording(path):
            raise RequestError(
                f"{path} is a recording, and has no objectives",
                hint="crossing takes runs: labrun import makes one of a recording",
            )
        run = open_run(path)
        runs[run.name] = run
    return runs


def _counted(run: Run) -> list[TrialOutcome]:
    return [outcome for outcome in run.outcomes if outcome.status == "done" and outcome.role != "reference"]


def _run_of(runs: Mapping[str, Run], table: CurveTable, target: str) -> Run:
    name = table.experiment or target
    if name not in runs:
        raise RequestError(
            f"{table.objective} is that of {name}, and only {', '.join(runs)} was given",
            hint=f"labrun fit {target} --with {name}",
        )
    known = dict.fromkeys(objective for trial in _counted(runs[name]) for objective in trial.objectives)
    if table.objective not in known:
        hint = suggest(table.objective, known, kind="objectives")
        raise RequestError(f"{name} has no objective {table.objective!r}", hint=hint)
    return runs[name]


def _levels(trials: Sequence[TrialOutcome], by: str | None) -> list[tuple[str, float | str] | None]:
    if by is None:
        return [None]
    levels = dict.fromkeys(trial.condition[by] for trial in trials if by in trial.condition)
    if not levels:
        raise RequestError(f"no trial has the condition {by!r} of fit.settings.by")
    return [(by, value) for value in sorted(levels, key=str)]


def _name(level: tuple[str, float | str] | None, names: Mapping[str, str]) -> str:
    if level is None:
        return ""
    name = level[1] if isinstance(level[1], str) else f"{level[1]:g}"
    return names.get(name, name)


def _curve(
    run: Run, keys: CrossingSettings, table: CurveTable, level: tuple[str, float | str] | None
) -> Measured:
    wanted = {**table.where, **({} if level is None else dict([level]))}
    own = [
        trial
        for trial in _counted(run)
        if all(trial.condition.get(name) == value for name, value in wanted.items())
        and table.objective in trial.objectives
    ]
    if not own:
        raise FitError(f"no trial of {run.name} that counts has {condition_text(wanted)}")
    places = [trial.condition.get(keys.over) for trial in own]
    numbers = [position for position in places if isinstance(position, int | float)]
    if len(numbers) < len(places):
        known = dict.fromkeys(name for trial in own for name in trial.condition)
        raise RequestError(
            f"trials of {run.name} have no number for the condition {keys.over!r}",
            hint=f"fit.settings.over is one of {', '.join(known)}",
        )
    different, terms = len(set(numbers)), len(table.powers)
    if different < terms:
        raise FitError(
            f"{condition_text(wanted) or run.name}: {different} values of {keys.over} are too few for a curve of "
            f"{terms} terms",
            hint=f"measure at {terms} or more, or give the curve fewer powers",
        )
    values = np.array([table.scale * trial.objectives[table.objective] for trial in own])
    return Measured(np.array(numbers, dtype=float), values, table.powers)


def _gains(
    measured: Mapping[str, Measured], at: float, unit: str, objective: str, rng: np.random.Generator
) -> list[str]:
    """Say how much greater each level's curve is than the lowest one, at one place."""
    draws = {
        name: curve.coefficients(curve.drawn(rng)) @ curve.terms(np.array([at]))[0]
        for name, curve in measured.items()
    }
    lowest = min(draws, key=lambda name: float(draws[name][0]))
    if draws[lowest][0] <= 0.0:
        return []
    notes = []
    for name, values in draws.items():
        if name == lowest:
            continue
        ratio = 100.0 * (values / draws[lowest] - 1.0)
        low, high = np.percentile(ratio[1:], [2.5, 97.5])
        notes.append(
            f"at {at:g} {unit} {name} has {ratio[0]:+.0f} % {objective} against {lowest} ({low:+.0f} to {high:+.0f} %)"
        )
    return notes


def _drawn(curve: Measured, label: str, series: int) -> list[Curve]:
    line = np.linspace(curve.x.min(), curve.x.max(), 80)
    fitted = np.asarray(curve.terms(line) @ curve.coefficients(curve.y))
    return [Curve(curve.x, curve.y, series, label, kind="points"), Curve(line, fitted, series)]
