"""How many trials a run will take, as far as its file says."""

import math
from collections.abc import Sequence

from labrun.search.design import Condition
from labrun.spec.experiment import CmaEs, Experiment


def expected_trials(experiment: Experiment, conditions: Sequence[Condition]) -> int | None:
    """Return the number of trials of a whole run; None if only the search itself will know.

    Parameters
    ----------
    conditions
        Of a `run` or a `sweep`; of a search, which has no list, they do not matter.

    Notes
    -----
    Counts the least number of repeats, the reference trials, and the trials that name and confirm the honest best.
    """
    stop = experiment.cmaes.stop if experiment.kind == "cmaes" and experiment.cmaes is not None else None
    if stop is not None and (stop.stagnation is not None or stop.step_size_below is not None):
        return None
    return most_trials(experiment, conditions)


def most_trials(experiment: Experiment, conditions: Sequence[Condition]) -> int:
    """Return `expected_trials`, for a search the most that its stop rules allow.

    Candidates that may not run, and rules that end a search sooner, make it less; restarts are counted with the
    first population.
    """
    if experiment.kind == "cmaes" and experiment.cmaes is not None:
        measured = _most_of_search(experiment.cmaes, experiment.trial.repeats.min)
    else:
        measured = len(conditions) * experiment.trial.repeats.min
    reference = experiment.trial.reference
    references = 0 if reference is None else math.ceil(measured / reference.every)
    leaders = experiment.leaders
    count = leaders.count if experiment.kind == "cmaes" else min(leaders.count, len(conditions))
    honest = 0 if experiment.goal is None else (count + 1) * leaders.repeats
    return measured + references + honest


def _most_of_search(search: CmaEs, repeats: int) -> int:
    population = search.population or 4 + int(3 * math.log(len(search.variables)))
    most = search.stop.iterations * population * repeats
    return most if search.stop.trials is None else min(most, search.stop.trials)
