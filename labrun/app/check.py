"""The check of a whole plan: nothing is connected, moved or written."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from labrun.control import ClosedLoopRecorder
from labrun.errors import PlanError, SpecError
from labrun.runner import ConditionExcess, Plan, Planner, Rig
from labrun.search import (
    ConstraintError,
    allowed_points,
    at_points,
    conditions,
    most_trials,
    survey_space,
)
from labrun.spec import Condition, Experiment, LoadedExperiment, load_named
from labrun.store import lacking_room


def check(
    experiment: str | Path | LoadedExperiment,
    *,
    dry_run: bool = False,
    overrides: Sequence[str] = (),
    seed: int = 0,
    workspace: str | Path = ".",
) -> Plan:
    """Return the whole plan, checked against every limit; nothing is connected, moved or written.

    A search chooses its conditions as it goes and keeps them inside the limits itself: its plan says how much of its
    space may run and what keeps out the rest, and the number of trials is the most that its stop rules allow.

    Parameters
    ----------
    experiment
        Its name, the path of its file, or one that is loaded already.
    dry_run
        Check as well that there is a bench to simulate.
    overrides
        Keys of the file to replace, such as ``trial.repeats=5``.
    seed
        Of random designs.
    workspace
        Where the experiment is looked for.

    Raises
    ------
    PlanError
        The constraints leave nothing, or a condition gives no motion. Conditions outside a limit stand in the
        plan; `Plan.require_feasible` makes an error of them.
    SpecError
        The file names what the rig does not have.
    """
    if isinstance(experiment, LoadedExperiment):
        loaded = experiment
    else:
        loaded = load_named(str(experiment), Path(workspace), overrides)
    if dry_run and loaded.experiment.rig.scene is None:
        raise SpecError(
            f"{loaded.path} names no scene, so there is no bench to simulate",
            hint='add scene = "..." to [rig]; labrun plugins lists the scenes',
        )
    return whole_plan(loaded, seed, None)


def require_room(plan: Plan, results: str | Path) -> None:
    """Raise PlanError if what a plan will write does not fit on the disk of the results."""
    problem = lacking_room(Path(results), plan.disk_bytes)
    if problem is not None:
        raise PlanError(problem, hint="make room, or name another disk with --results")


def whole_plan(loaded: LoadedExperiment, seed: int, rig: Rig | None) -> Plan:
    """Return the plan of every trial; `rig` is one that is built already, as a run has it."""
    experiment = loaded.experiment
    planner = Planner(experiment, rig)
    try:
        found = _search_plan(experiment, planner) if experiment.kind == "cmaes" else None
        chosen = [] if found is not None else conditions(experiment, seed)
    except ConstraintError as error:
        raise SpecError(f"{loaded.place(error.key)}: {error}") from error
    if experiment.kind == "track":
        ClosedLoopRecorder(experiment, planner.rig).require_makeable(chosen)
    found = _counted(planner.plan(chosen) if found is None else found, experiment, chosen)
    reference = experiment.trial.reference
    if reference is not None:
        excess = planner.excess_of(reference.condition)
        if excess:
            found = replace(
                found, excess=(*found.excess, ConditionExcess(reference.condition, tuple(excess)))
            )
    return found


def _search_plan(experiment: Experiment, planner: Planner) -> Plan:
    """Return the plan of the points that a search's constraints allow: those outside a limit never run."""
    assert experiment.cmaes is not None  # noqa: S101  (the file would not have loaded)
    allowed = allowed_points(experiment.cmaes)
    found = planner.plan(allowed.conditions or conditions(experiment))
    space = survey_space(experiment, allowed, found, planner.excess_of)
    outside = {id(item) for item in at_points(found.excess, allowed.conditions)}
    return replace(found, space=space, excess=tuple(item for item in found.excess if id(item) not in outside))


def _counted(found: Plan, experiment: Experiment, chosen: Sequence[Condition]) -> Plan:
    """Count every trial of the run: references and the honest best as well, and all that a search may take."""
    repeats, leaders = experiment.trial.repeats, experiment.leaders.count
    least = most_trials(experiment, chosen)
    most = most_trials(experiment, chosen, repeats=repeats.max)
    notes = found.notes
    written = "count" in experiment.leaders.model_fields_set
    if experiment.goal is not None and chosen and len(chosen) < leaders and written:
        notes = (
            *notes,
            f"leaders.count = {leaders} is more than the {len(chosen)} conditions: all of them are measured again",
        )
    return replace(
        found,
        trials=least,
        trials_at_most=most,
        time_s=found.time_s / found.trials * least,
        time_at_most_s=found.time_at_most_s / found.trials_at_most * most,
        disk_bytes=int(found.disk_bytes / found.trials * least),
        notes=notes,
    )
