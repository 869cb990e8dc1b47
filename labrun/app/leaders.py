"""Use the leaders of one run as conditions of another."""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from labrun.errors import RequestError
from labrun.experiment import (
    Condition,
    Experiment,
    LeadersOf,
    LoadedExperiment,
    condition_key,
    find_beside,
    load_experiment,
    loads_experiment,
)
from labrun.report import experiment_of
from labrun.search import NUMBER, conditions, leading_conditions, levels_of
from labrun.store import TrialOutcome, find_run, is_finished, mean_truncation, open_run
from labrun.toml import written_in_order


def with_leaders(loaded: LoadedExperiment, results: Path, *, planned: bool = False) -> LoadedExperiment:
    """Return an experiment with ``leaders_of`` replaced by the leaders.

    Leaders that are to be measured beside its own are left out as long as there is no run of them.

    Parameters
    ----------
    loaded
        Any experiment; one that asks for no leaders is returned as it is.
    results
        Where runs are.
    planned
        Where a run is not there yet, take the point that its search starts from: enough to check a plan.

    Raises
    ------
    RequestError
        A run that is not there, did not finish, has no leaders, or is of another rig.
    """
    experiment = loaded.experiment
    listed = experiment.run.conditions if experiment.run is not None and experiment.kind == "run" else None
    given = experiment.leaders.beside
    if not planned and missing_beside(experiment, results):
        given = []
    if not isinstance(listed, LeadersOf) and not isinstance(given, LeadersOf):
        return loaded
    tree = tomllib.loads(loaded.resolved_toml)
    if isinstance(listed, LeadersOf):
        points, tree["run"]["taken_from"] = _taken(listed, loaded, results, planned=planned)
        tree["run"]["conditions"] = [
            {NUMBER: float(number), **condition} for number, condition in enumerate(points, 1)
        ]
    if isinstance(given, LeadersOf):
        tree["leaders"]["beside"], tree["leaders"]["taken_from"] = _taken(
            given, loaded, results, planned=planned
        )
    made = loads_experiment(written_in_order(tree), loaded.name)
    return replace(made, path=loaded.path, origins=loaded.origins)


def missing_beside(experiment: Experiment, results: Path) -> list[str]:
    """Return the experiments named by ``leaders.beside`` that have no run yet."""
    given = experiment.leaders.beside
    return (
        [name for name in given.experiments if not _has_run(name, results)]
        if isinstance(given, LeadersOf)
        else []
    )


def _has_run(name: str, results: Path) -> bool:
    try:
        find_run(name, results)
    except RequestError:
        return False
    return True


def _taken(
    asked: LeadersOf, loaded: LoadedExperiment, results: Path, *, planned: bool
) -> tuple[list[dict[str, Any]], list[dict[str, str]]]:
    """Return the requested leaders and their runs."""
    taken: list[dict[str, Any]] = []
    sources = []
    for name in asked.experiments:
        if planned and not _has_run(name, results):
            theirs = load_experiment(find_beside(name, loaded.path)).experiment
            points = [{**levels_of(theirs)[0], **condition} for condition in conditions(theirs)]
            taken += [dict(points[index % len(points)]) for index in range(asked.count)]
            continue
        try:
            run = find_run(name, results)
        except RequestError as error:
            raise RequestError(
                f"{loaded.name} takes over the leaders of {name}, which has no run in {results}",
                hint=f"labrun cmaes {name}, and then this one",
            ) from error
        taken += [dict(leader) for leader in leaders_of(run, asked.count, loaded.experiment)]
        sources.append({"experiment": name, "run": run.parent.name if run.is_file() else run.name})
    return taken, sources


def leaders_of(run: Path, count: int, wanted: Experiment | None = None) -> list[Condition]:
    """Return the leaders of a finished run, ordered by their fresh repeats; other conditions follow.

    Parameters
    ----------
    run
        Its folder.
    count
        How many.
    wanted
        The experiment that is to use them: its gait has to move the same joints.

    Raises
    ------
    RequestError
        The run did not finish, has no goal, too few leaders, or is of another rig.
    """
    folder = run.parent if run.is_file() else run
    if not is_finished(folder):
        raise RequestError(
            f"{run} has not finished: its leaders were not measured again",
            hint=f"labrun resume {run}, or name another run",
        )
    with open_run(folder) as opened:
        experiment, outcomes = experiment_of(opened.experiment_toml, opened.name), opened.outcomes
    if wanted is not None:
        _require_same_rig(experiment, wanted, run)
    if experiment.goal is None:
        raise RequestError(f"{run} has no goal, so it has no leaders", hint="give an objective a goal")
    name, direction = experiment.goal
    led: list[Condition] = []
    for roles in (("fresh",), ("measure", "fresh", "confirm")):
        grouped: dict[object, list[TrialOutcome]] = {}
        for outcome in outcomes:
            if outcome.role in roles and outcome.status == "done" and name in outcome.objectives:
                own = own_values(outcome.condition, experiment)
                grouped.setdefault(condition_key(own), []).append(replace(outcome, condition=own))
        measured = [
            (
                group[0].condition,
                np.array([outcome.objectives[name] for outcome in group]),
                mean_truncation(group, name),
            )
            for group in grouped.values()
        ]
        known = {condition_key(condition) for condition in led}
        ranked = leading_conditions(measured, direction)
        led += [condition for condition in ranked if condition_key(condition) not in known]
    if len(led) < count:
        raise RequestError(
            f"{run} has {len(led)} conditions with an accepted trial, and {count} leaders are required",
            hint="a smaller count, or a run that measured more",
        )
    return led[:count]


def own_values(condition: Mapping[str, float | str], experiment: Experiment) -> dict[str, float | str]:
    """Return a condition without the settings that all candidates share."""
    return {name: value for name, value in condition.items() if name not in experiment.over}


def _require_same_rig(theirs: Experiment, ours: Experiment, run: Path) -> None:
    first, other = set(theirs.gait.joints), set(ours.gait.joints)
    if first != other or theirs.gait.plugin != ours.gait.plugin:
        joints, own = (", ".join(sorted(names)) or "nothing" for names in (first, other))
        raise RequestError(
            f'{run} is of another rig: its gait "{theirs.gait.plugin}" moves {joints}, '
            f'and "{ours.gait.plugin}" here moves {own}',
            hint="name a run whose gait moves the same joints",
        )
