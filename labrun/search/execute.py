"""New runs, and the check of a plan."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labrun.errors import SpecError
from labrun.search.design import conditions
from labrun.search.engine import Draw, carry_out, connected
from labrun.search.forecast import most_trials
from labrun.search.result import Best, RunResult
from labrun.search.resume import resume, source_of

if TYPE_CHECKING:
    from labrun.runner.plan import Plan
    from labrun.runner.progress import Progress
    from labrun.runner.rig import Rig
    from labrun.spec.experiment import Experiment
    from labrun.spec.loading import LoadedExperiment

__all__ = ["Best", "RunResult", "check", "execute", "resume"]


def check(loaded: "LoadedExperiment", *, dry_run: bool = False, seed: int = 0) -> "Plan":
    """Return the whole plan, checked against every limit; nothing is connected, moved or written.

    A search chooses its conditions as it goes and keeps them inside the limits itself: of its plan the starting
    point stands for all, and the number of trials is the most that its stop rules allow.

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
    return _plan(loaded.experiment, seed, None)


def execute(
    loaded: "LoadedExperiment",
    *,
    results: Path,
    dry_run: bool,
    seed: int | None = None,
    limit: int | None = None,
    progress: "Progress",
    draw: Draw | None = None,
) -> RunResult:
    """Run an experiment to its end: trials, honest best, run.h5, figure.

    Parameters
    ----------
    results
        The run's folder is made below it, once all devices have answered.
    dry_run
        Simulated devices in simulated time.
    seed
        Of all randomness; drawn if None, and stored with the run.
    limit
        Stop after this many trials; the run can be resumed.
    draw
        What draws the finished run; without it there is no picture.

    Raises
    ------
    RequestError
        The plan does not hold; nothing moved and nothing was written.
    ExperimentError, Interrupted
        The experiment failed, or was interrupted; the hint says what was saved and how to go on.
    """
    from labrun.runner.clock import RealClock, SimulatedClock
    from labrun.runner.rig import Rig
    from labrun.store.folder import RunFolder
    from labrun.store.provenance import collect

    if seed is None:
        seed = int(np.random.default_rng().integers(2**32))
    clock = SimulatedClock() if dry_run else RealClock()
    progress.phase("checking the plan")
    rig = Rig.build(loaded.experiment, clock=clock, seed=seed, dry_run=dry_run)
    _plan(loaded.experiment, seed, rig).require_feasible()
    progress.phase("connecting")
    with connected(rig):
        origin = {
            **collect(loaded.path.resolve().parent, seed=seed, devices=rig.identities()),
            **source_of(loaded.path),
            "dry_run": dry_run,
        }
        folder = RunFolder.create(results, loaded.name, loaded.resolved_toml, origin)
        return carry_out(loaded.experiment, rig, folder, seed=seed, limit=limit, progress=progress, draw=draw)


def _plan(experiment: "Experiment", seed: int, rig: "Rig | None") -> "Plan":
    from labrun.runner.plan import ConditionExcess, Planner, plan

    chosen = conditions(experiment, seed)
    found = plan(experiment, chosen, rig=rig)
    if experiment.kind == "cmaes":
        found = _as_search(found, experiment)
    reference = experiment.trial.reference
    if reference is not None:
        excess = Planner(experiment, rig).excess_of(reference.condition)
        if excess:
            found = replace(
                found, excess=(*found.excess, ConditionExcess(reference.condition, tuple(excess)))
            )
    return found


def _as_search(found: "Plan", experiment: "Experiment") -> "Plan":
    """Count the trials of a search; its start may lie outside a limit, since no candidate that does ever runs."""
    start = conditions(experiment)[0]
    excess = tuple(item for item in found.excess if item.condition != start)
    trials = most_trials(experiment, ())
    share = trials / found.trials
    most = experiment.trial.repeats.max / experiment.trial.repeats.min
    return replace(
        found,
        trials=trials,
        trials_at_most=round(trials * most),
        time_s=found.time_s * share,
        time_at_most_s=found.time_s * share * most,
        disk_bytes=int(found.disk_bytes * share),
        excess=excess,
    )
