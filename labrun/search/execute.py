"""New runs, and the check of a plan."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labrun.errors import SpecError
from labrun.search.constraints import ConstraintError
from labrun.search.design import Condition, conditions
from labrun.search.engine import Draw, carry_out, connected
from labrun.search.forecast import most_trials
from labrun.search.result import Best, RunResult
from labrun.search.resume import resume, source_of

if TYPE_CHECKING:
    from labrun.runner.plan import Plan, Planner
    from labrun.runner.progress import Progress
    from labrun.runner.rig import Rig
    from labrun.spec.experiment import Experiment
    from labrun.spec.loading import LoadedExperiment

__all__ = ["Best", "RunResult", "check", "execute", "resume"]


def check(loaded: "LoadedExperiment", *, dry_run: bool = False, seed: int = 0) -> "Plan":
    """Return the whole plan, checked against every limit; nothing is connected, moved or written.

    A search chooses its conditions as it goes and keeps them inside the limits itself: its plan says how much of its
    space may run and what keeps out the rest, and the number of trials is the most that its stop rules allow.

    Parameters
    ----------
    dry_run
        Check as well that there is a bench to simulate.
    seed
        Of random designs.

    Raises
    ------
    PlanError
        The constraints leave nothing, or a condition gives no motion. Conditions outside a limit stand in the
        plan; `Plan.require_feasible` makes an error of them.
    SpecError
        The file names what the rig does not have.
    """
    if dry_run and loaded.experiment.rig.scene is None:
        raise SpecError(
            f"{loaded.path} names no scene, so there is no bench to simulate",
            hint='add scene = "..." to [rig]; labrun plugins lists the scenes',
        )
    return _plan(loaded, seed, None)


def execute(
    loaded: "LoadedExperiment",
    *,
    results: Path,
    dry_run: bool,
    emulate: bool = False,
    seed: int | None = None,
    limit: int | None = None,
    progress: "Progress",
    draw: Draw | None = None,
    hide: Sequence[str] = (),
    hide_seed: int | None = None,
) -> RunResult:
    """Run an experiment to its end: trials, honest best, run.h5, figure.

    Parameters
    ----------
    results
        The run's folder is made below it, once all devices have answered.
    dry_run
        Simulated devices in simulated time.
    emulate
        The real drivers in real time, against emulators of their devices.
    seed
        Of all randomness; drawn if None, and stored with the run.
    limit
        Stop after this many trials; the run can be resumed.
    draw
        What draws the finished run; without it there is no picture.
    hide
        Of a dry or emulated run: what its scene hides, see `labrun.runner.hiding.choose_hidden`; sealed with the
        run, and told nowhere else. Empty hides nothing and seals nothing.
    hide_seed
        Of what is drawn; drawn itself if None, and stored nowhere.

    Raises
    ------
    RequestError
        The plan does not hold; nothing moved and nothing was written.
    ExperimentError, Interrupted
        The experiment failed, or was interrupted; the hint says what was saved and how to go on.
    """
    from labrun.runner.clock import RealClock, SimulatedClock
    from labrun.runner.rig import Rig
    from labrun.search.emulated import behind_the_drivers
    from labrun.store.folder import RunFolder
    from labrun.store.provenance import collect
    from labrun.store.seal import SEALED, redacted, write_seal

    again = None
    if hide:
        from labrun.search.hidden import bench_of

        bench = bench_of(hide, results)
        if bench is not None:
            # the same bench: what was built from the seed there is built from it here
            seed, again = (bench[0] if seed is None else seed), bench[1]
    if seed is None:
        seed = int(np.random.default_rng().integers(2**32))
    clock = SimulatedClock() if dry_run else RealClock()
    progress.phase("checking the plan")
    on_bench, seal = loaded.experiment, None
    if hide:
        from labrun.search.hidden import sealed_choice

        on_bench, seal = sealed_choice(
            loaded, hide, seed=hide_seed, simulated=dry_run or emulate, again=again
        )
    with behind_the_drivers(on_bench, loaded.path, seed=seed, emulate=emulate, progress=progress) as emulated:
        rig = Rig.build(on_bench, clock=clock, seed=seed, dry_run=dry_run, emulated=emulated)
        _plan(loaded, seed, rig).require_feasible()
        progress.phase("connecting")
        with connected(rig):
            origin = {
                **collect(loaded.path.resolve().parent, seed=seed, devices=rig.identities()),
                **source_of(loaded.path),
                "dry_run": dry_run,
                "emulated": emulate,
            }
            if seal is not None:
                origin |= {SEALED: seal.sha256, "command": redacted(origin["command"])}
            folder = RunFolder.create(results, loaded.name, loaded.resolved_toml, origin)
            if emulated is not None:
                emulated.keep_logs(folder.path / "emulated")
            if seal is not None:
                write_seal(folder.path, seal)
                progress.note(f"sealed what this run hides: sha256 {seal.sha256[:16]}")
            return carry_out(
                loaded.experiment, rig, folder, seed=seed, limit=limit, progress=progress, draw=draw
            )


def _plan(loaded: "LoadedExperiment", seed: int, rig: "Rig | None") -> "Plan":
    from labrun.runner.plan import ConditionExcess, Planner

    experiment = loaded.experiment
    planner = Planner(experiment, rig)
    try:
        found = _search_plan(experiment, planner) if experiment.kind == "cmaes" else None
        chosen = [] if found is not None else conditions(experiment, seed)
    except ConstraintError as error:
        raise SpecError(f"{loaded.place(error.key)}: {error}") from error
    if experiment.kind == "track":
        from labrun.control.conductor import LoopConductor

        LoopConductor(experiment, planner.rig).require_makeable(chosen)
    found = _counted(planner.plan(chosen) if found is None else found, experiment, chosen)
    reference = experiment.trial.reference
    if reference is not None:
        excess = planner.excess_of(reference.condition)
        if excess:
            found = replace(
                found, excess=(*found.excess, ConditionExcess(reference.condition, tuple(excess)))
            )
    return found


def _search_plan(experiment: "Experiment", planner: "Planner") -> "Plan":
    """Return the plan of the points that a search's constraints allow: those outside a limit never run."""
    from labrun.search.survey import allowed_points, at_points, survey

    assert experiment.cmaes is not None  # noqa: S101  (the file would not have loaded)
    allowed = allowed_points(experiment.cmaes)
    found = planner.plan(allowed.conditions or conditions(experiment))
    space = survey(experiment, allowed, found, planner.excess_of)
    outside = {id(item) for item in at_points(found.excess, allowed.conditions)}
    return replace(found, space=space, excess=tuple(item for item in found.excess if id(item) not in outside))


def _counted(found: "Plan", experiment: "Experiment", chosen: Sequence[Condition]) -> "Plan":
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
