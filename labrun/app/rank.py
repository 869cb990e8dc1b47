"""Compare the order of gaits in the laboratory and in the field, and recommend a gait."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labrun.app.leaders import own_values
from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.experiment import Condition, Experiment, condition_key
from labrun.report import experiment_of
from labrun.search import NUMBER, Cell, FieldColumn, Ranking, agreement, pooled_intervals
from labrun.store import TrialOutcome, find_run, mean_truncation, open_run, replace_durably

FILE = "ranking.json"


def rank(
    laboratories: Sequence[str],
    field: str,
    *,
    objective: str | None = None,
    seed: int = 0,
    results: str | Path = "results",
) -> Ranking:
    """Compare the order of gaits in the laboratory and in the field, recommend a gait, and store the result.

    Parameters
    ----------
    laboratories
        Runs that the gaits were found or measured in: an experiment's name (its latest run) or a run folder.
    field
        The run in the field; its conditions are the gaits, and its settings (`run.over`) the waters.
    objective
        Of the field; the one with a goal, or the first, if None.
    seed
        Of the resampling.
    results
        Where runs are.

    Raises
    ------
    RequestError
        A run that is not there, no trial that counts, an unknown objective, or conditions that are no gaits.
    """
    results = Path(results)
    label, outcomes, experiment, _ = _run(field, results)
    name, maximise = _objective(experiment, objective)
    counted = [
        outcome
        for outcome in outcomes
        if outcome.status == "done" and outcome.role != "reference" and name in outcome.objectives
    ]
    if not counted:
        reasons = (
            "; ".join(dict.fromkeys(outcome.reason for outcome in outcomes if outcome.reason))
            or "none was run"
        )
        raise RequestError(
            f"{label} has no accepted trial: {reasons}", hint=f"labrun resume {label}, or run it again"
        )
    notes: list[str] = []
    gaits = _gaits(experiment, counted, label)
    labs: dict[str, dict[object, FloatArray]] = {}
    units: dict[str, str] = {}
    for target in laboratories:
        path, theirs, maximised, units[path] = _laboratory(target, results)
        labs[path] = theirs if maximised == maximise else {key: -values for key, values in theirs.items()}
        common = sum(_key(gait) in theirs for gait in gaits)
        if common < len(gaits):
            some = "none" if common == 0 else f"{common}"
            notes.append(f"{path} measured {some} of the {len(gaits)} gaits of {label}")
    rng = np.random.default_rng(np.random.SeedSequence((seed, len(counted))))
    columns = []
    for setting in _settings(counted, experiment):
        values = [_values(_trials(counted, gait, setting), name) for gait in gaits]
        measured = {_key(gait): value for gait, value in zip(gaits, values, strict=True) if len(value)}
        agreements = {}
        for path, lab in labs.items():
            both = [key for key in measured if key in lab]
            agreements[path] = agreement([lab[key] for key in both], [measured[key] for key in both], rng)
        cut = [mean_truncation(_trials(counted, gait, setting), name) for gait in gaits]
        cells = tuple(
            Cell(float(value.mean()), interval, len(value)) if len(value) else None
            for value, interval in zip(values, pooled_intervals(values, cut), strict=True)
        )
        columns.append(FieldColumn(setting, cells, agreements))
    table = experiment.objectives[name]
    made = Ranking(
        label,
        tuple(labs),
        name,
        str(table.settings.get("unit", "")),
        maximise,
        tuple(gaits),
        {
            path: tuple(float(lab[_key(g)].mean()) if _key(g) in lab else None for g in gaits)
            for path, lab in labs.items()
        },
        tuple(columns),
        None,
        tuple(notes),
        units,
        experiment.units,
    )
    made = _with_winner(made)
    replace_durably(Path(label) / FILE, json.dumps(made.to_json(), indent=2).encode())
    return made


def _with_winner(ranking: Ranking) -> Ranking:
    sign = 1.0 if ranking.maximise else -1.0
    worst: dict[int, float] = {}
    for index in range(len(ranking.gaits)):
        bounds = [ranking.bound(column, index) for column in ranking.columns]
        known = [sign * bound for bound in bounds if bound is not None]
        if len(known) == len(bounds):
            worst[index] = min(known)
    if not worst:
        note = "no gait has two trials that count in every water, so that none can be taken"
        return replace(ranking, notes=(*ranking.notes, note))
    best = max(worst.values())
    first, *tied = [index for index, bound in worst.items() if bound == best]
    if tied:
        names = ", ".join(ranking.name(index) for index in (first, *tied))
        return replace(ranking, winner=first, notes=(*ranking.notes, f"{names} are tied; the first is taken"))
    return replace(ranking, winner=first)


def _run(target: str, results: Path) -> tuple[str, list[TrialOutcome], Experiment, dict[str, str]]:
    """Return a run's folder, trials, experiment, and the units of its conditions and objectives."""
    run = find_run(target, results)
    folder = run.parent if run.is_file() else run
    with open_run(folder) as opened:
        experiment = experiment_of(opened.experiment_toml, opened.name)
        return str(folder), list(opened.outcomes), experiment, opened.units()


def _objective(experiment: Experiment, asked: str | None) -> tuple[str, bool]:
    if asked is not None:
        if asked not in experiment.objectives:
            raise RequestError(
                f"the field has no objective {asked!r}", hint=f"it has {', '.join(experiment.objectives)}"
            )
        goal = experiment.objectives[asked].goal
        return asked, goal != "minimise"
    if experiment.goal is not None:
        return experiment.goal[0], experiment.goal[1] == "maximise"
    if not experiment.objectives:
        raise RequestError("the field has no objective", hint="give its file one, for example asked")
    return next(iter(experiment.objectives)), True


def _gaits(experiment: Experiment, counted: Sequence[TrialOutcome], label: str) -> list[Condition]:
    conditions: dict[object, Condition] = {}
    for outcome in counted:
        gait = own_values(outcome.condition, experiment)
        conditions.setdefault(condition_key(gait), gait)
    if len(conditions) < 2:
        raise RequestError(
            f"{label} tried {len(conditions)} gait; a ranking needs two",
            hint=f"labrun resume {label}, if it has not finished, or more gaits in [run] conditions",
        )
    return sorted(conditions.values(), key=lambda gait: float(gait.get(NUMBER, 0.0)))


def _settings(counted: Sequence[TrialOutcome], experiment: Experiment) -> list[Condition]:
    settings = (
        {name: outcome.condition[name] for name in experiment.over if name in outcome.condition}
        for outcome in counted
    )
    known = {condition_key(setting): setting for setting in settings}
    return [known[key] for key in sorted(known, key=str)]


def _trials(counted: Sequence[TrialOutcome], gait: Condition, setting: Condition) -> list[TrialOutcome]:
    wanted = condition_key({**gait, **setting})
    return [outcome for outcome in counted if condition_key(outcome.condition) == wanted]


def _values(trials: Sequence[TrialOutcome], name: str) -> FloatArray:
    return np.array([trial.objectives[name] for trial in trials], dtype=float)


def _key(gait: Condition) -> object:
    """Return the key of a gait across runs: its values without its number."""
    return condition_key({name: value for name, value in gait.items() if name != NUMBER})


def _laboratory(target: str, results: Path) -> tuple[str, dict[object, FloatArray], bool, str]:
    """Return the values of each condition of a laboratory run: its fresh repeats where there are any, else all.

    Before them the run's folder; behind them whether the goal is a maximum, and the objective's unit.
    """
    label, outcomes, experiment, units = _run(target, results)
    if experiment.goal is None:
        raise RequestError(
            f"{label} has no goal, so its gaits cannot be ranked", hint="name a search or a sweep with a goal"
        )
    name, direction = experiment.goal
    values_of: dict[object, list[float]] = {}
    for roles in (("fresh", "confirm"), ("measure",)):
        taken: dict[object, list[float]] = {}
        for outcome in outcomes:
            if outcome.role in roles and outcome.status == "done" and name in outcome.objectives:
                taken.setdefault(_key(own_values(outcome.condition, experiment)), []).append(
                    outcome.objectives[name]
                )
        for key, values in taken.items():
            values_of.setdefault(key, values)
    values_by_gait = {key: np.array(values) for key, values in values_of.items()}
    return label, values_by_gait, direction == "maximise", units.get(name, "")
