"""What a run's trials say of the bench: repeatability, drift and how to remove it, settling."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.report.data import Point, RunView, experiment_of
from labrun.search import scatter
from labrun.store import Run, TrialOutcome


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Spread of an objective within and between conditions.

    Attributes
    ----------
    sd
        Standard deviation of single trials of one condition (in one mounting), pooled over all that were repeated.
    degrees_of_freedom
        Behind `sd`.
    mounting_sd, mountings
        Standard deviation of what a mounting adds of its own, and by how many mountings beyond the first of each
        condition it is known; None and 0 where nothing was mounted again.
    between_sd
        Standard deviation of the conditions' means; None for a single condition.
    """

    objective: str
    unit: str
    sd: float
    degrees_of_freedom: int
    between_sd: float | None
    mounting_sd: float | None = None
    mountings: int = 0


@dataclass(frozen=True, slots=True)
class Drift:
    """Slope of an objective over the run, by its reference trials, with its 95 % interval, per hour of bench time."""

    objective: str
    unit: str
    slope_per_h: float
    ci95: tuple[float, float]
    trials: int

    @property
    def visible(self) -> bool:
        """Tell whether the interval excludes zero."""
        return not self.ci95[0] <= 0.0 <= self.ci95[1]


@dataclass(frozen=True, slots=True)
class Settling:
    """Settling statistics: counts by outcome, and durations."""

    reasons: dict[str, int]
    median_s: float
    longest_s: float


def repeatability(view: RunView) -> list[Repeatability]:
    """Return the repeatability of every objective that was measured more than once at some condition."""
    scatters = []
    for name in view.experiment.objectives:
        points = view.points(name)
        found_scatter = scatter((point.values, point.mountings) for point in points)
        sd, freedom = found_scatter.within, found_scatter.within_freedom
        between, mountings = found_scatter.between, found_scatter.between_freedom
        if sd is None and between is not None:  # one trial a mounting: what is of either cannot be told apart
            sd, freedom, between, mountings = between, mountings, None, 0
        if sd is not None:
            unit = view.unit_of(name)
            scatters.append(Repeatability(name, unit, sd, freedom, _between(points), between, mountings))
    return scatters


def repeatability_columns(repeatabilities: Sequence[Repeatability]) -> tuple[str, ...]:
    """Return the headings of a table of standard deviations: with mountings where any was repeated."""
    if all(item.mounting_sd is None for item in repeatabilities):
        return "sd within a condition", "sd between conditions"
    return "sd within a mounting", "sd between mountings", "sd between conditions"


def standard_deviations(
    repeatability: Repeatability, repeatabilities: Sequence[Repeatability]
) -> list[float | None]:
    """Return what stands under `repeatability_columns` for one objective."""
    if all(other.mounting_sd is None for other in repeatabilities):
        return [repeatability.sd, repeatability.between_sd]
    return [repeatability.sd, repeatability.mounting_sd, repeatability.between_sd]


def drift(view: RunView) -> list[Drift]:
    """Return the drift of every objective by least squares over at least three reference trials."""
    trends = []
    for name in view.experiment.objectives:
        hours, values = reference_values(view, name)
        if len(hours) < 3 or np.ptp(hours) == 0.0:
            continue
        slope, square, half_sd = _line(hours, values)
        half = half_sd / math.sqrt(square)
        trends.append(Drift(name, view.unit_of(name), slope, (slope - half, slope + half), len(hours)))
    return trends


def scaled_to_largest(values: FloatArray) -> FloatArray:
    """Return the values divided by their largest magnitude, so that their squares stay within floating-point range."""
    largest = float(np.max(np.abs(values), initial=0.0))
    return values / largest if 0.0 < largest < math.inf else values


def root_mean_square(values: FloatArray) -> float:
    """Return the root mean square, also of values whose squares exceed the floating-point range."""
    largest = float(np.max(np.abs(values)))
    return largest * float(np.sqrt(np.mean(np.square(scaled_to_largest(values))))) if largest else 0.0


def _line(hours: FloatArray, values: FloatArray) -> tuple[float, float, float]:
    """Return the least-squares slope, the sum of squares of `hours`, and what 95 % of the residuals lie within."""
    from scipy.stats import t  # slow to import

    centred = hours - hours.mean()
    square = float(centred @ centred)
    slope = float(centred @ values) / square
    residual = values - values.mean() - slope * centred
    freedom = len(hours) - 2
    return slope, square, float(t.ppf(0.975, freedom)) * math.sqrt(float(residual @ residual) / freedom)


def settling(outcomes: Iterable[TrialOutcome]) -> Settling | None:
    """Return settling statistics; None if the experiment does not settle."""
    summaries = [outcome.settle for outcome in outcomes if outcome.settle is not None]
    if not summaries:
        return None
    durations = np.array([summary.duration_s for summary in summaries])
    reasons = dict(Counter(summary.reason for summary in summaries).most_common())
    return Settling(reasons, float(np.median(durations)), float(durations.max()))


def _between(points: Sequence[Point]) -> float | None:
    means = [point.mean for point in points]
    return float(np.std(means, ddof=1)) if len(means) > 1 else None


def reference_values(view: RunView, objective: str) -> tuple[FloatArray, FloatArray]:
    """Return hours since the run's first trial and values of the accepted reference trials, both (n,)."""
    start_s = view.run.outcomes[0].started_s if view.run.outcomes else 0.0
    trials = [
        outcome
        for outcome in view.run.outcomes
        if outcome.role == "reference" and outcome.status == "done" and objective in outcome.objectives
    ]
    hours = np.array([(outcome.started_s - start_s) / 3600 for outcome in trials])
    return hours, np.array([outcome.objectives[objective] for outcome in trials])


def line_band(hours: FloatArray, values: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares line and the half-width of its 95 % confidence band.

    Parameters
    ----------
    hours, values : (n,)
        At least three points that are not all at one time.
    at : (m,)
        Where line and band are wanted.

    Returns
    -------
    line, half : (m,)
        Working-Hotelling is not used: the band holds at each point, not for the line as a whole.
    """
    slope, square, half_sd = _line(hours, values)
    away = at - hours.mean()
    return values.mean() + slope * away, half_sd * np.sqrt(1 / len(hours) + away**2 / square)


def spreads(view: RunView, objective: str) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Return mean, standard deviation and number of trials of every condition that was repeated, each (n,)."""
    points = [point for point in view.points(objective) if len(point.values) > 1]
    return (
        np.array([point.mean for point in points]),
        np.array([point.values.std(ddof=1) for point in points]),
        np.array([len(point.values) for point in points], dtype=np.int64),
    )


def chance_band(sd: float, repeats: int) -> tuple[float, float]:
    """Return within what 95 % of the standard deviations of `repeats` values lie if the true one is `sd`.

    Of normal values: s^2 (n - 1) / sd^2 has a chi-squared distribution with n - 1 degrees of freedom.
    """
    from scipy.stats import chi2

    low, high = (float(chi2.ppf(q, repeats - 1)) for q in (0.025, 0.975))
    return sd * math.sqrt(low / (repeats - 1)), sd * math.sqrt(high / (repeats - 1))


def grows_with_size(means: FloatArray, sds: FloatArray) -> float | None:
    """Return Spearman's correlation of spread and size of the mean where it is beyond chance (p < 0.01), else None."""
    from scipy.stats import spearmanr

    if len(means) < 8 or np.ptp(np.abs(means)) == 0.0 or np.ptp(sds) == 0.0:
        return None
    correlation: Any = spearmanr(np.abs(means), sds)
    return float(correlation.statistic) if float(correlation.pvalue) < 0.01 else None


DRIFT_SUFFIX = "_drift_corrected"


def drift_of(run: Run) -> list[Drift]:
    """Return the drift of every objective that at least three reference trials measured.

    Raises
    ------
    RequestError
        There are not so many, or the run's clock began anew in its course, so that their times do not compare.
    """
    trends = drift(RunView(run, experiment_of(run.experiment_toml, run.name), None))
    if not trends:
        references = sum(o.role == "reference" and o.status == "done" for o in run.outcomes)
        raise RequestError(
            f"no drift can be removed from {run.path}: it takes three accepted reference trials at different times, "
            f"and there are {references or 'none'}",
            hint="trial.reference in the experiment file asks for one every so many trials",
        )
    starts = [outcome.started_s for outcome in run.outcomes]
    if any(later < earlier for earlier, later in pairwise(starts)):
        raise RequestError(
            f"no drift can be removed from {run.path}: its clock restarted during the run (the machine was rebooted), "
            "so times before and after cannot be compared",
            hint="export it without --remove-drift",
        )
    return trends


def without_drift(outcomes: Sequence[TrialOutcome], drifts: Sequence[Drift]) -> list[TrialOutcome]:
    """Return the trials with an objective more for every one that drifts: ``<objective>_drift_corrected``.

    From each value the line through the reference trials is subtracted, from where it stands at the first trial's
    start: values become those the bench would have given then. The objectives themselves stay as measured.

    Parameters
    ----------
    outcomes
        Of one run, in the order they ran.
    drifts
        From `drift_of`.
    """
    start_s = outcomes[0].started_s if outcomes else 0.0
    return [
        replace(
            outcome,
            objectives=outcome.objectives
            | {
                f"{item.objective}{DRIFT_SUFFIX}": outcome.objectives[item.objective]
                - item.slope_per_h * (outcome.started_s - start_s) / 3600
                for item in drifts
                if item.objective in outcome.objectives
            },
        )
        for outcome in outcomes
    ]
