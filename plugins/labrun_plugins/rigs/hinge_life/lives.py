"""The fit ``life``: cycles to failure after Weibull, where some specimens outlive the test; and how they tire."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from labrun.devices import FloatArray
from labrun.errors import FitError, RequestError
from labrun.fit import (
    Curve,
    Estimate,
    FigureData,
    FitJob,
    FitSummary,
    FittedData,
    Panel,
    Run,
    Stack,
    TextTable,
    TrialOutcome,
    WithSettings,
    condition_text,
    open_run,
)
from labrun.toml import Keys, nearest

CYCLES = "cycles"
_DRAWS = 4000
_FEWEST_FAILURES = 2
_SHAPES = (0.05, 200.0)
"""Shapes between which the likelihood is searched; lives that differ by less than a per cent have none."""


class LifeSettings(Keys):
    """Keys of ``[fit.settings]``.

    Attributes
    ----------
    specimen
        Name of the condition that numbers specimens; those that differ in nothing else are of one kind.
    load
        Objective whose course over the cycles is told; none if it is not there.
    """

    specimen: str = "specimen"
    load: str = "peak_torque"


@dataclass(frozen=True, slots=True)
class Life:
    """Lives of one kind of specimen.

    Attributes
    ----------
    cycles : (n,)
    failed : (n,)
        False where the specimen outlived the test: its life is more than `cycles`.
    """

    kind: str
    cycles: FloatArray
    failed: FloatArray
    courses: tuple[FloatArray, ...] = ()

    @property
    def failures(self) -> int:
        """How many failed."""
        return int(np.count_nonzero(self.failed))


@dataclass(frozen=True, slots=True)
class Weibull:
    """Probability of surviving n cycles: ``exp(-(n / scale)^shape)``."""

    shape: float
    scale: float

    @property
    def median(self) -> float:
        """Life that half of the specimens reach."""
        return float(self.scale * math.log(2.0) ** (1.0 / self.shape))

    def survival(self, cycles: FloatArray) -> FloatArray:
        """Return the share that is still alive."""
        return np.asarray(np.exp(-((cycles / self.scale) ** self.shape)))


class LifeFit(WithSettings[LifeSettings]):
    """Weibull lives with right-censoring, for every kind of specimen."""

    Settings: ClassVar[type[BaseModel]] = LifeSettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit.

        Raises
        ------
        RequestError
            The run's trials do not run until something happens.
        FitError
            No accepted trial.
        """
        load = self._settings.load
        with open_run(job.target) as run:
            lives, left_out = _lives(run, self._settings)
            name = run.name
        parameters, fitted = dict[str, Estimate](), dict[str, Weibull]()
        findings, falls, rows = list[str](), list[str](), list[tuple[str, str]]()
        for life in lives:
            prefix, count = f"{life.kind}: " if life.kind else "", len(life.cycles)
            each = [
                f"{cycles:.0f}" if failed else f"> {cycles:.0f}"
                for cycles, failed in zip(life.cycles, life.failed, strict=True)
            ]
            rows.append((life.kind or "all", ", ".join(each)))
            fall = falls_per_decade(life)
            if fall is not None:
                falls.append(f"{prefix}{load} falls by {100 * fall:.2g} % per decade of cycles")
            if life.failures < _FEWEST_FAILURES:
                findings.append(prefix + _outlived(life))
                continue
            weibull = fitted[life.kind] = fit_weibull(life.cycles, life.failed)
            median, shape = intervals(weibull, count, life.failures, job.rng)
            # polyester_120 for layup = polyester, range = 120
            word = "_".join(["", *(part.partition(" = ")[2] for part in life.kind.split(", ") if part)])
            parameters[f"median{word}"] = Estimate(weibull.median, median, "cycles")
            parameters[f"shape{word}"] = Estimate(weibull.shape, shape, "1")
            if life.failures < count:
                alive = count - life.failures
                findings.append(f"{prefix}{alive} of {count} outlived the test and count as more than it")
        return FitSummary(
            method="life",
            model_name="life",
            data=FittedData(name, "run", sum(len(life.cycles) for life in lives), left_out),
            parameters=parameters,
            tables=(TextTable("cycles to failure", ("", "each specimen"), tuple(rows)),),
            findings=(*findings, *falls),
            details={
                "lives": [
                    {
                        "kind": life.kind,
                        "cycles": life.cycles.tolist(),
                        "censored": [not failed for failed in life.failed],
                    }
                    for life in lives
                ]
            },
            figure_data=lambda: _figure(name, lives, fitted, load),
        )


def fit_weibull(cycles: FloatArray, failed: FloatArray) -> Weibull:
    """Return the Weibull distribution of greatest likelihood; at least two must have failed, at different lives."""
    shape, scale = _solved(np.log(cycles)[None], np.asarray(failed, dtype=float)[None])
    return Weibull(float(shape[0]), float(scale[0]))


def intervals(
    weibull: Weibull, count: int, failures: int, rng: np.random.Generator
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return 95 % intervals of median and shape.

    (estimate - truth) / estimated spread of log life has a distribution that depends on the number of specimens only;
    it is drawn, which makes the interval exact for any number if all failed (Thoman, Bain and Antle, 1969). With
    survivors, samples are drawn whose longest lives are cut off likewise.
    """
    lives = np.sort(np.log(-np.log1p(-rng.random((_DRAWS, count)))), axis=1)  # shape and scale 1
    failed = np.zeros((_DRAWS, count))
    failed[:, :failures] = 1.0
    lives[:, failures:] = lives[:, failures - 1 : failures]
    shape, scale = _solved(lives, failed)
    centre = math.log(math.log(2.0))
    pivot = shape * (np.log(scale) + centre / shape - centre)
    low, high = np.percentile(pivot, [2.5, 97.5])
    thin, wide = np.percentile(shape, [2.5, 97.5])
    ends = (weibull.median * math.exp(-high / weibull.shape), weibull.median * math.exp(-low / weibull.shape))
    return ends, (weibull.shape / float(wide), weibull.shape / float(thin))


def _solved(logs: FloatArray, failed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return shape and scale, each (m,), of samples of log life (m, n): bisection on the likelihood's derivative."""
    top = logs.max(axis=1, keepdims=True)
    shifted = logs - top
    count = failed.sum(axis=1)
    mean = (failed * shifted).sum(axis=1) / count
    low, high = (np.full(len(logs), math.log(end)) for end in _SHAPES)
    for _ in range(60):
        middle = 0.5 * (low + high)
        power = np.exp(np.exp(middle)[:, None] * shifted)
        slope = (power * shifted).sum(axis=1) / power.sum(axis=1) - np.exp(-middle) - mean
        low, high = np.where(slope < 0, middle, low), np.where(slope < 0, high, middle)
    shape = np.exp(0.5 * (low + high))
    power = np.exp(shape[:, None] * shifted).sum(axis=1)
    return shape, np.exp(top[:, 0] + np.log(power / count) / shape)


def falls_per_decade(life: Life) -> float | None:
    """Return by which share the load falls while cycles grow tenfold, mean over specimens; None if not known."""
    lives = []
    for course in life.courses:
        # what happens at the end is the failure itself
        alive = np.abs(course[: max(int(0.9 * len(course)), 1)])
        if len(alive) < 20:
            continue
        decades = np.log10(np.arange(1, len(alive) + 1))
        slope, level = np.polyfit(decades, alive, 1)
        lives.append(-slope / level)
    return float(np.mean(lives)) if lives else None


def _lives(run: Run, settings: LifeSettings) -> tuple[list[Life], int]:
    done = [outcome for outcome in run.outcomes if outcome.status == "done"]
    if not done:
        raise FitError(f"nothing to fit in {run.path}: it has no accepted trial")
    if any(CYCLES not in outcome.objectives for outcome in done):
        raise RequestError(
            f"{run.name} has no lives to fit: its trials do not run until something happens",
            hint="give the experiment a table [trial.until]",
        )
    groups: dict[str, list[TrialOutcome]] = {}
    for outcome in done:
        others = {name: value for name, value in outcome.condition.items() if name != settings.specimen}
        groups.setdefault(condition_text(others), []).append(outcome)
    lives = []
    for kind, outcomes in groups.items():
        cycles = np.array([outcome.objectives[CYCLES] for outcome in outcomes])
        failed = np.array([not outcome.censored for outcome in outcomes])
        lives.append(
            Life(kind, cycles, failed, tuple(_course(run, outcome, settings) for outcome in outcomes))
        )
    return lives, len(run.outcomes) - len(done)


def _course(run: Run, outcome: TrialOutcome, settings: LifeSettings) -> FloatArray:
    table = run.tables(outcome.index).get(CYCLES)
    if table is None:
        return np.empty(0)
    if settings.load not in table.columns:
        near = nearest(settings.load, table.columns)
        listed = f"they have {', '.join(table.columns)}: --set load=NAME"
        hint = f"did you mean {near!r}?" if near else listed
        raise RequestError(f"the cycles of {run.name} have no {settings.load!r}", hint=hint)
    return np.asarray(table.signal(settings.load).values)


def _outlived(life: Life) -> str:
    """Say what is known where fewer than two failed: never a number for the life."""
    failed, count = life.failed.astype(bool), len(life.cycles)
    survived = life.cycles[~failed]
    if not life.failures:
        sure = 1.0 - 0.5**count
        return (
            f"> {float(survived.min()):,.0f} cycles: all {count} outlived the test; that half of such specimens do is "
            f"{100 * sure:.0f} % sure"
        )
    at = float(life.cycles[failed][0])
    if not len(survived):
        return f"one specimen only, which failed after {at:,.0f} cycles: no distribution and no interval"
    return (
        f"one of {count} failed, after {at:,.0f} cycles, the others live > {float(survived.min()):,.0f}: "
        "too few failures for a distribution"
    )


def _figure(name: str, lives: Sequence[Life], fitted: Mapping[str, Weibull], load: str) -> FigureData:
    """Return shares alive over cycles, and the load over cycles."""
    alive, courses = [], []
    for number, life in enumerate(lives):
        order = np.argsort(life.cycles, kind="stable")
        cycles, failed = life.cycles[order], life.failed[order].astype(bool)
        left = np.arange(len(cycles), 0, -1)
        share = np.cumprod(np.where(failed, 1.0 - 1.0 / left, 1.0))  # Kaplan and Meier
        x = np.concatenate([[1.0], cycles])
        alive.append(Curve(x, np.concatenate([[1.0], share]), number, life.kind or "measured", kind="steps"))
        if life.kind in fitted:
            smooth = np.geomspace(max(float(cycles.min()) / 10.0, 1.0), 2.0 * float(cycles.max()), 200)
            alive.append(Curve(smooth, fitted[life.kind].survival(smooth), number, dashed=True))
        for index, course in enumerate(life.courses):
            if len(course):
                at = np.unique(np.geomspace(1, len(course), 400).astype(int))
                label = life.kind if index == 0 else ""
                courses.append(Curve(at.astype(float), np.abs(course[at - 1]), number, label))
    panels = [Panel(tuple(alive), "alive", x_label="cycles", y_label="share", log="x", y_range=(0.0, 1.05))]
    if courses:
        panels.append(Panel(tuple(courses), load, x_label="cycles", y_label=load, log="x"))
    stacks = tuple(Stack((panel,), width=1.3) for panel in panels)
    return FigureData(f"Lives of {name}\nSteps: measured; dashed: Weibull", (stacks,))
