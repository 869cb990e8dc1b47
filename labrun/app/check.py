"""The check of a whole plan: nothing is connected, moved or written."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from labrun.app.leaders import with_leaders
from labrun.errors import PlanError, RequestError, SpecError
from labrun.experiment import (
    Condition,
    Experiment,
    LoadedExperiment,
    condition_key,
    condition_text,
    find_experiment,
    load_named,
)
from labrun.runner import (
    ConditionExcess,
    MotionMaker,
    Plan,
    Planner,
    Rig,
    SimulatedClock,
    untared_objectives,
)
from labrun.search import (
    ConstraintError,
    allowed_points,
    at_points,
    at_settings,
    conditions,
    excess_at_settings,
    levels_of,
    most_trials,
    settings_of,
    survey_space,
)
from labrun.store import find_data, is_recording, lacking_room

NO_SCENE = "[rig] names no scene: joints follow their commands, sensors read zero and their own noise"

_MOST_LISTED = 6


def check(
    experiment: str | Path | LoadedExperiment,
    *,
    dry_run: bool = False,
    overrides: Sequence[str] = (),
    seed: int = 0,
    results: str | Path = "results",
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
        Check as well that there is a bench to simulate, and that it has the joints and signals of the devices.
    overrides
        Keys of the file to replace, such as ``trial.repeats=5``.
    seed
        Of random designs.
    results
        Where runs are whose leaders become conditions; where there is none yet, the start of its search stands in.
    workspace
        Where the experiment is looked for.

    Raises
    ------
    PlanError
        The constraints leave nothing, or a condition gives no motion. Conditions outside a limit stand in the
        plan; `Plan.require_feasible` makes an error of them.
    SpecError
        The file names what the rig does not have.
    DeviceError
        A dry run's bench lacks what a device moves or measures.
    """
    if isinstance(experiment, LoadedExperiment):
        loaded = experiment
    else:
        loaded = load_named(str(experiment), Path(workspace), overrides)
    if loaded.experiment.kind == "design":
        from labrun.app.design import design_plan

        return design_plan(loaded)
    loaded = with_leaders(loaded, Path(results), planned=True)
    plan = whole_plan(loaded, seed, None)
    if not dry_run:
        return plan
    if loaded.experiment.rig.scene is None:
        return replace(plan, notes=(*plan.notes, NO_SCENE))
    with Rig.build(loaded.experiment, clock=SimulatedClock(), seed=seed, dry_run=True):
        return plan  # every device found what it needs on the bench


def is_meant_as_recording(target: str) -> bool:
    """Tell whether a target names a recording: its folder, its recording.toml, or its name."""
    path = Path(target).expanduser()
    if path.name == "recording.toml" or is_recording(path):
        return True
    try:
        find_experiment(target, Path())
    except RequestError:
        another = path.is_file() and path.suffix != ".toml"  # a log, a robot: what takes it is told
        return another or path.is_dir() or _is_named_recording(target)
    return False


def _is_named_recording(target: str) -> bool:

    try:
        return is_recording(find_data(target, Path("results")))
    except RequestError:
        return False


def require_room(plan: Plan, results: str | Path) -> None:
    """Raise PlanError if what a plan will write does not fit on the disk of the results."""
    problem = lacking_room(Path(results), plan.disk_bytes)
    if problem is not None:
        raise PlanError(problem, hint="make room, or name another disk with --results")


def whole_plan(
    loaded: LoadedExperiment, seed: int, rig: Rig | None, motions: MotionMaker | None = None
) -> Plan:
    """Return the plan of every trial; `rig` and `motions` are those of a resumed run."""
    experiment = loaded.experiment
    planner = Planner(experiment, rig, motions)
    try:
        plan = _search_plan(experiment, planner) if experiment.kind == "cmaes" else None
        asked = [] if plan is not None else conditions(experiment, seed)
        chosen = at_settings(asked, settings_of(experiment))
    except ConstraintError as error:
        raise SpecError(f"{loaded.origin_of(error.key)}: {error}") from error
    columns_hz = 0.0
    if experiment.kind == "track":
        from labrun.control import ClosedLoopRecorder

        recorder = ClosedLoopRecorder(experiment, planner.rig)
        recorder.require_makeable(chosen)
        columns_hz = recorder.columns_hz
    plan = _counted(
        planner.plan(chosen, more_columns_hz=columns_hz) if plan is None else plan,
        experiment,
        chosen,
        len(asked),
    )
    plan = replace(plan, notes=(*plan.notes, *untared_objectives(experiment, planner.rig)))
    reference = experiment.trial.reference
    guests = at_settings(
        experiment.leaders.guests, at_settings(levels_of(experiment), settings_of(experiment))
    )
    for guest in [*guests, *([] if reference is None else [reference.condition])]:
        excess = planner.excess_of(guest)
        if excess:
            plan = replace(plan, excess=(*plan.excess, ConditionExcess(guest, tuple(excess))))
    return plan


def _search_plan(experiment: Experiment, planner: Planner) -> Plan:
    """Return the plan of the points that the constraints of a search allow."""
    assert experiment.cmaes is not None  # noqa: S101  (the file would not have loaded)
    allowed = allowed_points(experiment.cmaes)
    settings = at_settings(levels_of(experiment), settings_of(experiment))
    plan = planner.plan(at_settings(allowed.conditions or conditions(experiment), settings))
    plan = replace(plan, excess=_of_candidates(plan.excess, allowed.conditions, settings))
    space = survey_space(experiment, allowed, plan, excess_at_settings(planner.excess_of, settings))
    outside = {id(item) for item in at_points(plan.excess, allowed.conditions)}
    return replace(plan, space=space, excess=tuple(item for item in plan.excess if id(item) not in outside))


def _of_candidates(
    excess: Sequence[ConditionExcess], candidates: Sequence[Condition], settings: Sequence[Condition]
) -> tuple[ConditionExcess, ...]:
    """Return the limit violations of each candidate, without the settings in the condition."""
    names = {name for setting in settings for name in setting}
    if not names:
        return tuple(excess)
    known = {condition_key(candidate) for candidate in candidates}
    excesses: dict[object, ConditionExcess] = {}
    for item in excess:
        own = {name: value for name, value in item.condition.items() if name not in names}
        key = condition_key(own)
        excesses.setdefault(key, ConditionExcess(own, item.excess) if key in known else item)
    return tuple(excesses.values())


def _counted(plan: Plan, experiment: Experiment, chosen: Sequence[Condition], count: int) -> Plan:
    """Return the number of trials, including references, the confirmed best, and the budget of a search.

    `chosen` are its conditions, at each setting; without the settings there are `count` of them.
    """
    repeats, leaders = experiment.trial.repeats, experiment.leaders.count
    own = chosen[:count]  # as many as there are without settings: they are counted alone
    least = most_trials(experiment, own, repeats=repeats.min)
    most = most_trials(experiment, own)
    notes = plan.notes
    written = "count" in experiment.leaders.model_fields_set
    if experiment.goal is not None and chosen and count < leaders and written:
        notes = (
            *notes,
            f"leaders.count = {leaders} is more than the {count} conditions: all of them are measured again",
        )
    if experiment.damage is not None:
        notes = (*notes, *_damage_notes(experiment, chosen))
    by_hand = experiment.by_hand
    if by_hand is not None:
        mounted = chosen or levels_of(experiment)  # candidates of a search are mounted by their level
        groups = len({condition_key(by_hand.values(condition)) for condition in mounted})
        count, what = groups * by_hand.mountings, ", ".join(by_hand.names)
        some = "1 mounting" if count == 1 else f"{count} mountings"
        notes = (*notes, f"{some} of {what} by hand: how long that takes is not counted")
    return replace(
        plan,
        trials=least,
        trials_at_most=most,
        time_s=plan.time_s / plan.trials * least,
        time_at_most_s=plan.time_at_most_s / plan.trials_at_most * most,
        disk_bytes=int(plan.disk_bytes / plan.trials * least),
        disk_kept_bytes=int(plan.disk_kept_bytes / plan.trials * least),
        notes=notes,
    )


def _damage_notes(experiment: Experiment, chosen: Sequence[Condition]) -> list[str]:
    """Return notes on conditions that damage the specimen.

    Raises
    ------
    PlanError
        There are some, and the file does not allow it.
    """
    table = experiment.damage
    if table is None or table.when is None:
        return []
    damaging = [condition for condition in chosen if table.when(condition)]
    if damaging and not table.allow_damage:
        listed = "".join(
            f"\n  {condition_text(condition, experiment.units)}" for condition in damaging[:_MOST_LISTED]
        )
        more = f"\n  and {len(damaging) - _MOST_LISTED} more" if len(damaging) > _MOST_LISTED else ""
        raise PlanError(
            f"{len(damaging)} of {len(chosen)} conditions would damage what they are measured on "
            f"(damage.when: {table.when.text}):{listed}{more}",
            hint="damage.allow_damage = true lets them run, last of all, once on each specimen; or leave them out",
        )
    count = len(damaging)
    return (
        [f"{count} conditions damage what they are measured on: they come last, once on each"]
        if count
        else []
    )
