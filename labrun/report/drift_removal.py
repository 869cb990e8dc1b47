"""A run's objectives without the drift that its reference trials show."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

from labrun.errors import RequestError
from labrun.report.data import RunView
from labrun.report.recorded import experiment_of
from labrun.report.statistics import Drift, drift
from labrun.store import TrialOutcome

if TYPE_CHECKING:
    from labrun.store import Run

SUFFIX = "_drift_corrected"


def drift_of(run: "Run") -> list[Drift]:
    """Return the drift of every objective that at least three reference trials measured.

    Raises
    ------
    RequestError
        There are not so many, or the run's clock began anew in its course, so that their times do not compare.
    """
    found = drift(RunView(run, experiment_of(run.experiment_toml, run.name), None))
    if not found:
        references = sum(o.role == "reference" and o.status == "done" for o in run.outcomes)
        raise RequestError(
            f"no drift can be removed from {run.path}: it takes three accepted reference trials at different times, "
            f"and there are {references or 'none'}",
            hint="trial.reference in the experiment file asks for one every so many trials",
        )
    starts = [outcome.started_s for outcome in run.outcomes]
    if any(later < earlier for earlier, later in pairwise(starts)):
        raise RequestError(
            f"no drift can be removed from {run.path}: its clock began anew in its course (the machine was restarted), "
            "so that times before and after do not compare",
            hint="export it without --remove-drift",
        )
    return found


def without_drift(outcomes: Sequence[TrialOutcome], found: Sequence[Drift]) -> list[TrialOutcome]:
    """Return the trials with an objective more for every one that drifts: ``<objective>_drift_corrected``.

    From each value the line through the reference trials is subtracted, from where it stands at the first trial's
    start: values become those the bench would have given then. The objectives themselves stay as measured.

    Parameters
    ----------
    outcomes
        Of one run, in the order they ran.
    found
        From `drift_of`.
    """
    start_s = outcomes[0].started_s if outcomes else 0.0
    return [
        replace(
            outcome,
            objectives=outcome.objectives
            | {
                f"{item.objective}{SUFFIX}": outcome.objectives[item.objective]
                - item.slope_per_h * (outcome.started_s - start_s) / 3600
                for item in found
                if item.objective in outcome.objectives
            },
        )
        for outcome in outcomes
    ]
