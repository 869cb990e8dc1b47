"""A run from its open rig to its picture; the same for a new run and for one that is resumed."""

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import ExperimentError
from labrun.search.design import conditions
from labrun.search.ending import resumable, terminate_like_interrupt
from labrun.search.forecast import expected_trials
from labrun.search.leaders import Measured, honest_best
from labrun.search.result import Best, RunResult, reason_lines, resume_line
from labrun.search.watching import BestSoFar
from labrun.spec.experiment import Experiment
from labrun.spec.track_tables import LOOP_DEVICE

if TYPE_CHECKING:
    from labrun.runner.progress import Progress
    from labrun.runner.recording import Conduct
    from labrun.runner.rig import Rig
    from labrun.runner.session import Session
    from labrun.store.folder import RunFolder

RESULT_FILE = "result.json"

Draw = Callable[[Path, Best | None], Path | None]
"""Draws a run into its folder and returns the picture; given by whoever starts the run: reports stand above it."""


def carry_out(
    experiment: Experiment,
    rig: "Rig",
    folder: "RunFolder",
    *,
    seed: int,
    limit: int | None,
    progress: "Progress",
    draw: Draw | None = None,
) -> RunResult:
    """Measure, name the honest best, pack, draw; trials that are stored already are not run again.

    Raises
    ------
    Interrupted
        Ctrl-C, or a request to terminate.
    ExperimentError
        The experiment failed. As after an interrupt, the hint says how to go on. Or it came to its end without an
        answer, see `require_answer`: the data are packed.
    """
    from labrun.runner.faults import LimitReached
    from labrun.runner.session import Session

    goal = experiment.goal
    unit = objective_unit(experiment, rig, goal[0]) if goal is not None else ""
    if goal is not None:
        progress = BestSoFar(progress, *goal, unit, experiment.trial.repeats.min)
    with folder.lock(), resumable(folder), terminate_like_interrupt():
        session = Session(
            experiment, rig, folder, rig.clock, seed, progress, limit, _conduct(experiment, rig)
        )
        try:
            best = _measure(experiment, rig, session, folder, seed, unit, progress)
        except LimitReached:
            folder.journal.append("limit-reached", limit=limit)
            progress.note(f"stopped after {limit} new trials; to go on: {resume_line(folder.path)}")
            return _result(folder, best=None, figure=None, finished=False)
        result = _finish(folder, best, progress, draw)
    return require_answer(result, experiment)


def require_answer(result: RunResult, experiment: Experiment) -> RunResult:
    """Return the result of a finished run if it answers anything.

    Raises
    ------
    ExperimentError
        No trial was accepted, or there is a goal and no best could be named. The run stays packed and readable.
    """
    if result.done == 0:
        problem = "no trial was accepted"
    elif experiment.goal is not None and result.best is None:
        name, direction = experiment.goal
        problem = f"nothing can be named that would {direction} {name}: too few trials were accepted"
    else:
        return result
    counts = f"{result.done} done, {result.rejected} rejected, {result.failed} failed"
    error = ExperimentError(
        "\n".join([f"{problem} ({counts})", *reason_lines(result.reasons)]),
        hint=f"everything recorded is kept and packed in {result.run}: labrun show {result.run}; "
        "mend the cause and start a new run",
    )
    error.details.update(result.to_json())
    raise error


@contextmanager
def connected(rig: "Rig") -> Iterator["Rig"]:
    """Hold every port of a rig and its devices open; a second run on one of the ports is refused.

    Raises
    ------
    RigBusyError
        Another run holds a port; nothing was connected.
    DeviceError
        A device cannot be opened.
    """
    from labrun.runner.ports import ports_of
    from labrun.store.rig_lock import lock_ports

    # Emulators' ports are the run's own, and two such runs do not meet.
    settings = [] if rig.dry_run or rig.emulated else [item.settings for item in rig.resolved]
    ports = [port for table in settings for port in ports_of(table)]
    with lock_ports(ports) if ports else nullcontext(), rig:
        yield rig


def stored_result(run: Path) -> RunResult | None:
    """Return the result of a finished run; None if the run is not finished."""
    path = run / RESULT_FILE
    if not path.is_file():
        return None
    record = json.loads(path.read_text(encoding="utf-8"))
    trials = record["trials"]
    figure = run / record["figure"] if record["figure"] is not None else None
    best = None if record["best"] is None else Best.from_record(record["best"])
    return RunResult(
        run,
        trials["done"],
        trials["rejected"],
        trials["failed"],
        best,
        figure,
        finished=True,
        reasons=record.get("reasons", {}),
        unsettled=record.get("unsettled", 0),
    )


def _measure(
    experiment: Experiment,
    rig: "Rig",
    session: "Session",
    folder: "RunFolder",
    seed: int,
    unit: str,
    progress: "Progress",
) -> Best | None:
    found: Sequence[Measured]
    if experiment.kind == "cmaes":
        from labrun.runner.plan import Planner
        from labrun.search.cmaes import search_by_cmaes

        _expect(session, folder, expected_trials(experiment, ()))
        found = search_by_cmaes(
            experiment,
            session,
            folder.path / "search",
            limit_excesses=Planner(experiment, rig).excess_of,
            seed=seed,
            progress=progress,
        )
    else:
        planned = conditions(experiment, seed)
        table = {"run": experiment.run, "track": experiment.track}.get(experiment.kind, experiment.sweep)
        _expect(session, folder, expected_trials(experiment, planned))
        found = session.measure(planned, order="shuffled" if table is None else table.order)
    if experiment.goal is None:
        return None
    progress.phase("fresh repeats of the leaders")
    name, direction = experiment.goal
    return honest_best(session, found, objective=name, goal=direction, unit=unit, leaders=experiment.leaders)


def _conduct(experiment: Experiment, rig: "Rig") -> "Conduct":
    """Return how trials are recorded: with the loops closed where the experiment has any."""
    if experiment.kind == "track":
        from labrun.control.conductor import LoopConductor

        return LoopConductor(experiment, rig)
    from labrun.runner.recording import conduct_as_planned

    return conduct_as_planned


def _expect(session: "Session", folder: "RunFolder", trials: int | None) -> None:
    """Say how many trials there will be, here and to whoever watches the run from elsewhere."""
    folder.journal.append("expected", sync=False, trials=trials)
    session.expect(trials)


def objective_unit(experiment: Experiment, rig: "Rig", name: str) -> str:
    """Return the unit of an objective: its channel's, or what the objective makes of it."""
    from labrun.objectives import make_objective

    table = experiment.objectives[name]
    device, _, channel = (table.channel or "").partition(".")
    sensor = rig.sensors.get(device)
    units = {item.name: item.unit for item in sensor.channels} if sensor is not None else {}
    if device == LOOP_DEVICE and experiment.kind == "track":
        from labrun.control.conductor import LoopConductor

        units = {item.name: item.unit for item in LoopConductor(experiment, rig).channels}
    return make_objective(name, table).unit(units.get(channel, ""))


def _finish(folder: "RunFolder", best: Best | None, progress: "Progress", draw: Draw | None) -> RunResult:
    from labrun.store.disk import replace_durably, saving

    progress.phase("packing run.h5")
    result = _result(folder, best=best, figure=None, finished=True)
    folder.pack()
    figure = None if draw is None else _drawn(draw, folder.path, best, progress)
    record = {
        **result.to_json(),
        "run": folder.path.name,
        "best": None if best is None else best.to_record(),
        "figure": None if figure is None else figure.name,
        "reasons": dict(result.reasons),
        "unsettled": result.unsettled,
    }
    with saving(RESULT_FILE, folder.path):
        replace_durably(folder.path / RESULT_FILE, json.dumps(record, indent=2).encode())
    if result.unsettled:
        folder.journal.append("unsettled", trials=result.unsettled, of=result.done)
        progress.note(result.unsettled_text())
    folder.journal.append("finished", trials=record["trials"])
    return _result(folder, best=best, figure=figure, finished=True)


def _drawn(draw: Draw, run: Path, best: Best | None, progress: "Progress") -> Path | None:
    """Draw the run. Whatever goes wrong with a picture, the data are safe and the run counts as done."""
    progress.phase("drawing")
    try:
        return draw(run, best)
    except Exception as error:
        progress.note(f"the figure could not be drawn: {type(error).__name__}: {error}")
        return None


def _result(folder: "RunFolder", *, best: Best | None, figure: Path | None, finished: bool) -> RunResult:
    from labrun.runner.settling import unsettled

    outcomes = list(folder.outcomes().values())
    statuses = [outcome.status for outcome in outcomes]
    done, rejected, failed = (statuses.count(status) for status in ("done", "rejected", "failed"))
    reasons = Counter(
        f"{outcome.status}: {outcome.reason}" for outcome in outcomes if outcome.status != "done"
    )
    timed_out = sum(unsettled(outcome) for outcome in outcomes)
    return RunResult(
        folder.path, done, rejected, failed, best, figure, finished, dict(reasons.most_common()), timed_out
    )
