"""How many trials a run will take, as far as its file says."""

import math
from collections.abc import Sequence

from labrun.search.design import Condition
from labrun.spec import CmaEs, Experiment


def expected_trials(experiment: Experiment, conditions: Sequence[Condition]) -> int | None:
    """Return the greatest number of trials that a whole run can have; None would be an open end, and no run has one.

    Parameters
    ----------
    conditions
        Of a `run` or a `sweep`; of a search, which has no list, they do not matter.

    Notes
    -----
    Counts the greatest number of repeats, the reference trials, and the trials that name and confirm the honest best.
    A search that stagnates ends sooner, and candidates that may not run take no trial.
    """
    return most_trials(experiment, conditions, repeats=experiment.trial.repeats.max)


def most_trials(
    experiment: Experiment, conditions: Sequence[Condition], *, repeats: int | None = None
) -> int:
    """Return the number of trials with so many repeats of a condition, for a search the most its stop rules allow.

    Parameters
    ----------
    repeats
        The least number that the file allows, if None.
    """
    least = experiment.trial.repeats.min
    repeats = least if repeats is None else repeats
    candidates = len(conditions)
    measured = candidates * repeats
    if experiment.kind == "cmaes" and experiment.cmaes is not None:
        candidates, measured = _most_of_search(experiment.cmaes, least, repeats)
    reference = experiment.trial.reference
    references = 0 if reference is None else math.ceil(measured / reference.every)
    leaders = experiment.leaders
    honest = 0 if experiment.goal is None else (min(leaders.count, candidates) + 1) * leaders.repeats
    return measured + references + honest


def _most_of_search(search: CmaEs, least: int, repeats: int) -> tuple[int, int]:
    """Return the most candidates, and the most trials of them."""
    population = search.population_size * 2**search.restarts
    candidates = search.stop.iterations * population
    measured = candidates * repeats
    if search.stop.trials is not None:
        # A generation begins if its least number of repeats fits in; more repeats may carry it beyond. The first one
        # always begins.
        within = max(search.stop.trials, search.population_size * least)
        measured = min(measured, within + population * (repeats - least))
        candidates = min(candidates, within // least)
    return candidates, measured
