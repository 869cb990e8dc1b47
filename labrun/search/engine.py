"""A run from its open rig to its picture; the same for a new run and for one that is resumed."""

import json
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import LabrunError
from labrun.search.design import conditions
from labrun.search.forecast import expected_trials
from labrun.search.leaders import Measured, honest_best
from labrun.search.result import Best, RunResult, resume_line
from labrun.search.watching import BestSoFar
from labrun.spec.experiment import Experiment

if TYPE_CHECKING:
    from labrun.runner.progress import Progress
    from labrun.runner.rig import Rig
    from labrun.runner.session import Session
    from labrun.store.folder import RunFolder

RESULT_FILE = "result.json"

Draw = Callable[[Path, Best | None], Path | None]
"""Draws a run into its folder and returns the picture; given by whoever starts the run, since reports stand above searches."""


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
        The experiment failed. As after an interrupt, the hint says how to go on.
    """
    from labrun.runner.faults import LimitReached
    from labrun.runner.session import Session

    goal = experiment.goal
    unit = objective_unit(experiment, rig, goal[0]) if goal is not None else ""
    if goal is not None:
        progress = BestSoFar(progress, *goal, unit, experiment.trial.repeats.min)
    with folder.lock(), _resumable(folder), _terminate_like_interrupt():
        session = Session(experiment, rig, folder, rig.clock, seed, progress, limit)
        try:
            best = _measure(experiment, rig, session, folder.path, seed, unit, progress)
        except LimitReached:
            folder.journal.append("limit-reached", limit=limit)
            progress.note(f"stopped after {limit} new trials; to go on: {resume_line(folder.path)}")
            return _result(folder, best=None, figure=None, finished=False)
        return _finish(folder, best, progress, draw)


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
    from labrun.runner.ports import port_of
    from labrun.store.rig_lock import lock_ports

    settings = [] if rig.dry_run else [item.settings for item in rig.resolved]
    ports = [port for table in settings if (port := port_of(table) or getattr(table, "host", None))]
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
    return RunResult(run, trials["done"], trials["rejected"], trials["failed"], best, figure, finished=True)


def _measure(
    experiment: Experiment,
    rig: "Rig",
    session: "Session",
    run: Path,
    seed: int,
    unit: str,
    progress: "Progress",
) -> Best | None:
    found: Sequence[Measured]
    if experiment.kind == "cmaes":
        from labrun.runner.plan import Planner
        from labrun.search.cmaes import search_by_cmaes

        session.expect(expected_trials(experiment, ()))
        found = search_by_cmaes(
            experiment,
            session,
            run / "search",
            limit_excesses=Planner(experiment, rig).excess_of,
            seed=seed,
            progress=progress,
        )
    else:
        planned = conditions(experiment, seed)
        table = experiment.run if experiment.kind == "run" else experiment.sweep
        session.expect(expected_trials(experiment, planned))
        found = session.measure(planned, order="shuffled" if table is None else table.order)
    if experiment.goal is None:
        return None
    progress.phase("fresh repeats of the leaders")
    name, direction = experiment.goal
    return honest_best(session, found, objective=name, goal=direction, unit=unit, leaders=experiment.leaders)


def objective_unit(experiment: Experiment, rig: "Rig", name: str) -> str:
    """Return the unit of an objective: its channel's, or what the objective makes of it."""
    from labrun.objectives import make_objective

    table = experiment.objectives[name]
    device, _, channel = (table.channel or "").partition(".")
    sensor = rig.sensors.get(device)
    units = {item.name: item.unit for item in sensor.channels} if sensor is not None else {}
    return make_objective(name, table).unit(units.get(channel, ""))


def _finish(
    folder: "RunFolder", best: Best | None, progress: "Progress", draw: Draw | None
) -> RunResult:
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
    }
    with saving(RESULT_FILE, folder.path):
        replace_durably(folder.path / RESULT_FILE, json.dumps(record, indent=2).encode())
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
    statuses = [outcome.status for outcome in folder.outcomes().values()]
    done, rejected, failed = (statuses.count(status) for status in ("done", "rejected", "failed"))
    return RunResult(folder.path, done, rejected, failed, best, figure, finished)


@contextmanager
def _resumable(folder: "RunFolder") -> Iterator[None]:
    """Journal why a run ended early, and tell the person how to go on."""
    from labrun.runner.faults import Interrupted

    try:
        yield
    except KeyboardInterrupt as interrupt:  # between two measurements; during one the session sees to it
        _journal_end(folder, "interrupted", "Ctrl-C")
        message = f"interrupted by Ctrl-C: actuators are stopped, {_saved(folder)}"
        raise Interrupted(message, hint=_go_on(folder)) from interrupt
    except LabrunError as error:
        _journal_end(folder, "interrupted" if isinstance(error, Interrupted) else "failed", str(error))
        go_on = f"{_saved(folder)}; {_go_on(folder)}"
        error.hint = go_on if error.hint is None else f"{error.hint}\n  {go_on}"
        raise
    except Exception as error:
        _journal_end(folder, "failed", f"{type(error).__name__}: {error}")
        error.add_note(f"{_saved(folder)}; {_go_on(folder)}")
        raise


def _go_on(folder: "RunFolder") -> str:
    return f"to go on: {resume_line(folder.path)}"


def _journal_end(folder: "RunFolder", event: str, reason: str) -> None:
    try:
        folder.journal.append(event, reason=reason)
    except (OSError, LabrunError):  # a full disk: the error that brought us here tells more
        return


def _saved(folder: "RunFolder") -> str:
    try:
        count = len(folder.outcomes())
    except (OSError, LabrunError):
        return f"what was measured is kept in {folder.path}"
    return f"{count} trials are kept in {folder.path}"


@contextmanager
def _terminate_like_interrupt() -> Iterator[None]:
    """Let SIGTERM (a shutdown, a batch system) end a run as Ctrl-C does: actuators first, then the data."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_signal: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
