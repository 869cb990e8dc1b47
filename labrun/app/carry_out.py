"""A run from its open rig to its picture, new or resumed; and how it ends early: stopped, journalled, resumable."""

import json
import signal
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from labrun.app.answer import Answer, measure_all, search_folder
from labrun.errors import ExperimentError, LabrunError, PlanError
from labrun.objectives import make_objective
from labrun.report import RunView, experiment_of
from labrun.runner import (
    Interrupted,
    LimitReached,
    MotionMaker,
    Person,
    Progress,
    Recorder,
    Rig,
    Session,
    UntilRecorder,
    record_planned,
    unsettled,
    within_bounds,
    worn_specimens,
)
from labrun.search import RESULT_FILE, Best, RunResult, read_generations, reason_lines, resume_line
from labrun.spec import LOOP_DEVICE, Experiment, condition_key
from labrun.store import RunFolder, TrialOutcome, open_run, remarks_of, replace_durably, saving

FIGURE = "figure.png"


def carry_out(
    experiment: Experiment,
    rig: Rig,
    folder: RunFolder,
    *,
    seed: int,
    limit: int | None,
    progress: Progress,
    draw: bool = False,
    person: Person | None = None,
    motions: MotionMaker | None = None,
) -> RunResult:
    """Measure, name the honest best, pack, draw; trials that are stored already are not run again.

    `motions` are those made for the plan.

    Raises
    ------
    Interrupted
        Ctrl-C, or a request to terminate.
    ExperimentError
        The experiment failed. As after an interrupt, the hint says how to go on. Or it came to its end without an
        answer, see `require_answer`: the data are packed.
    """
    goal = experiment.goal
    unit = objective_unit(experiment, rig, goal[0]) if goal is not None else ""
    taken = None
    if goal is not None and not experiment.over:  # of a part of the settings nothing can be said
        taken = _BestSoFar(progress, *goal, unit, experiment.trial.repeats.min)
    with folder.lock(), resumable(folder), terminate_like_interrupt():
        session = Session(
            experiment,
            rig,
            folder,
            rig.clock,
            seed,
            progress,
            limit,
            within_bounds(_recorder(experiment, rig, folder, seed, progress), experiment),
            person,
            motions,
            worn_specimens(experiment, rig, folder),
            taken,
        )
        try:
            answer = measure_all(experiment, rig, session, folder, seed, unit, progress)
        except LimitReached:
            folder.journal.append("limit-reached", limit=limit)
            progress.note(f"stopped after {limit} new trials; to go on: {resume_line(folder.path)}")
            return _result(folder, best=None, figure=None, finished=False)
        result = finish(folder, answer, progress, draw)
    return require_answer(result, experiment)


def source_of(experiment_file: Path) -> dict[str, Any]:
    """Return what provenance keeps of the experiment file, for `changed_keys`: where it is, and its text."""
    text = experiment_file.read_text(encoding="utf-8") if experiment_file.is_file() else None
    return {"experiment_file": str(experiment_file.resolve()), "experiment_text": text}


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
        problem = (
            f"nothing can be named that would {direction} {name}: too few trials of the leaders were accepted"
        )
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


def _recorder(experiment: Experiment, rig: Rig, folder: RunFolder, seed: int, progress: Progress) -> Recorder:
    """Return how trials are recorded: with the loops closed, or cycle by cycle until an end, where asked for."""
    if experiment.kind == "track":
        from labrun.control import loop_recorder  # compiled loops

        return loop_recorder(experiment, rig)
    if experiment.trial.until is not None:
        return UntilRecorder(experiment, rig, folder, seed=seed, phase=progress.phase)
    return record_planned


def objective_unit(experiment: Experiment, rig: Rig, name: str) -> str:
    """Return the unit of an objective: its channel's, or what the objective makes of it."""
    table = experiment.objectives[name]
    device, _, channel = (table.channel or "").partition(".")
    sensor = rig.sensors.get(device)
    units = {item.name: item.unit for item in sensor.channels} if sensor is not None else {}
    if device == LOOP_DEVICE and experiment.kind == "track":
        from labrun.control import loop_recorder  # compiled loops

        units = {item.name: item.unit for item in loop_recorder(experiment, rig).channels}
    return make_objective(name, table).unit(units.get(channel, ""))


def finish(folder: RunFolder, answer: Answer, progress: Progress, draw: bool) -> RunResult:
    """Pack a run, draw it, and keep its result."""
    progress.phase("packing run.h5")
    best = answer.best

    def told(figure: Path | None) -> RunResult:
        result = _result(folder, best=best, figure=figure, finished=True)
        return replace(result, verdicts=answer.verdicts, winners=answer.winners, more=answer.more)

    result = told(None)
    folder.pack()
    figure = _drawn(folder.path, best, progress, answer.search) if draw else None
    record = {
        **result.to_json(),
        "run": folder.path.name,
        "best": None if best is None else best.to_record(),
        **({"winners": [one.to_record() for one in answer.winners]} if answer.winners else {}),
        "figure": None if figure is None else figure.name,
        "reasons": dict(result.reasons),
        "unsettled": result.unsettled,
        "more": list(answer.more),
    }
    with saving(RESULT_FILE, folder.path):
        replace_durably(folder.path / RESULT_FILE, json.dumps(record, indent=2).encode())
    if result.unsettled:
        folder.journal.append("unsettled", trials=result.unsettled, of=result.done)
        progress.note(result.unsettled_text())
    for remark in remarks_of(folder.journal.events()):
        progress.note(remark)
    folder.journal.append("finished", trials=record["trials"])
    return told(figure)


def draw(folder: Path, best: Best | None, search: int = 0) -> Path | None:
    """Draw a run as its kind asks for, into its folder; None where there is nothing to draw."""
    from labrun.report.figures import run_figure  # matplotlib
    from labrun.report.style import save

    with open_run(folder) as run:
        view = RunView(run, experiment_of(run.experiment_toml, run.name), best)
        figure = run_figure(view, read_generations(search_folder(folder, search)))
    return None if figure is None else save(figure, folder / FIGURE)


def _drawn(run: Path, best: Best | None, progress: Progress, search: int = 0) -> Path | None:
    """Draw the run. Whatever goes wrong with a picture, the data are safe and the run counts as done."""
    progress.phase("drawing")
    try:
        return draw(run, best, search)
    except Exception as error:
        progress.note(f"the figure could not be drawn: {type(error).__name__}: {error}")
        return None


def _result(folder: RunFolder, *, best: Best | None, figure: Path | None, finished: bool) -> RunResult:
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


@contextmanager
def resumable(folder: RunFolder, *, stopped: str = "actuators are stopped, ") -> Iterator[None]:
    """Journal why a run ended early, and tell the person how to go on."""
    try:
        yield
    except KeyboardInterrupt as interrupt:  # between two measurements; during one the session sees to it
        _journal_end(folder, "interrupted", "Ctrl-C")
        message = f"interrupted by Ctrl-C: {stopped}{_saved(folder)}"
        told = Interrupted(message, hint=_go_on(folder))
        told.details.update(_so_far(folder))
        raise told from interrupt
    except LabrunError as error:
        _journal_end(folder, "interrupted" if isinstance(error, Interrupted) else "failed", str(error))
        saved = _saved(folder) if isinstance(error, PlanError) else f"{_saved(folder)}; {_go_on(folder)}"
        error.hint = saved if error.hint is None else f"{error.hint}\n  {saved}"
        error.details.update(_so_far(folder))
        raise
    except Exception as error:
        _journal_end(folder, "failed", f"{type(error).__name__}: {error}")
        error.add_note(f"{_saved(folder)}; {_go_on(folder)}")
        raise


def _go_on(folder: RunFolder) -> str:
    return f"to go on: {resume_line(folder.path)}"


def _journal_end(folder: RunFolder, event: str, reason: str) -> None:
    try:
        folder.journal.append(event, reason=reason)
    except (OSError, LabrunError):  # a full disk: the error that brought us here tells more
        return


def _saved(folder: RunFolder) -> str:
    try:
        count = len(folder.outcomes())
    except (OSError, LabrunError):
        return f"what was measured is kept in {folder.path}"
    if not count and (generations := len(read_generations(folder.path / "search"))):
        return f"{generations} generations are kept in {folder.path}"
    kept = "1 trial is" if count == 1 else f"{count} trials are"
    return f"{kept} kept in {folder.path}"


def _so_far(folder: RunFolder) -> dict[str, Any]:
    """Return where the data are and what was done, for scripts."""
    try:
        statuses = [outcome.status for outcome in folder.outcomes().values()]
    except (OSError, LabrunError):
        return {"run": str(folder.path)}
    trials = {status: statuses.count(status) for status in ("done", "rejected", "failed")}
    return {"run": str(folder.path), "trials": trials}


@contextmanager
def terminate_like_interrupt() -> Iterator[None]:
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


class _BestSoFar:
    """Tells a progress display of each new best condition.

    The best so far is the best mean among the conditions with the full number of repeats (any, before there is one).
    It is what the search has in hand, and optimistic: the honest best comes at the end of the run.
    """

    def __init__(
        self,
        progress: Progress,
        objective: str,
        goal: Literal["maximise", "minimise"],
        unit: str,
        repeats: int,
    ) -> None:
        self._progress = progress
        self._objective = objective
        self._sign = 1.0 if goal == "maximise" else -1.0
        self._unit = unit
        self._repeats = repeats
        self._sums: dict[object, tuple[int, float]] = {}
        self._best: tuple[bool, float] | None = None

    def __call__(self, outcome: TrialOutcome) -> None:
        """Take in a trial."""
        if (
            outcome.status != "done"
            or outcome.role == "reference"
            or self._objective not in outcome.objectives
        ):
            return
        key = condition_key(outcome.condition)
        count, total = self._sums.get(key, (0, 0.0))
        count, total = count + 1, total + outcome.objectives[self._objective]
        self._sums[key] = (count, total)
        mean = total / count
        rank = (count >= self._repeats, self._sign * mean)
        if self._best is None or rank > self._best:
            self._best = rank
            self._progress.best(outcome.condition, mean, self._unit)
