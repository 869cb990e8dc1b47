"""Carry out a run on an open rig, new or resumed, and end it early so that it can be resumed."""

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from labrun.devices import Excess
from labrun.errors import ExperimentError, LabrunError, PlanError
from labrun.experiment import LOOP_DEVICE, Condition, Experiment, condition_text
from labrun.interrupts import Interrupted, handled, number_of, signal_name
from labrun.objectives import make_objective
from labrun.report import RunView, counted, experiment_of
from labrun.runner import (
    LimitReached,
    MotionMaker,
    Person,
    Planner,
    Progress,
    Recorder,
    Rig,
    Session,
    UntilRecorder,
    guard_excesses,
    record_planned,
    unsettled,
    within_bounds,
    worn_specimens,
)
from labrun.search import (
    RESULT_FILE,
    Best,
    BestSoFar,
    Feasibility,
    Measured,
    Measures,
    NoCandidateError,
    OverSettings,
    RunResult,
    Searched,
    Verdict,
    at_settings,
    combined_text,
    conditions,
    excess_at_settings,
    honest_best,
    levels_of,
    most_trials,
    range_end_notes,
    read_generations,
    reason_lines,
    resume_line,
    search_by_cmaes,
    settings_of,
)
from labrun.store import RunFolder, TrialOutcome, open_run, remarks_of, replace_durably, saving

FIGURE = "figure.png"


@dataclass(frozen=True, slots=True)
class Answer:
    """The confirmed best, the outcome of each search, the winner of each level, and the search that found the best."""

    best: Best | None = None
    verdicts: tuple[Verdict, ...] = ()
    winners: tuple[Best, ...] = ()
    search: int = 0
    more: tuple[str, ...] = ()
    """Lines that tell more of it."""


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
    """Measure, confirm the best, pack and plot; trials that are already stored are not repeated.

    `motions` are those made for the plan.

    Raises
    ------
    Interrupted
        Ctrl-C, SIGTERM or SIGHUP.
    ExperimentError
        The experiment failed. As after an interrupt, the hint says how to go on. Or it came to its end without an
        answer, see `require_answer`: the data are packed.
    """
    goal = experiment.goal
    unit = objective_unit(experiment, rig, goal[0]) if goal is not None else ""
    so_far = None if goal is None else BestSoFar(*goal, experiment.trial.repeats.min)

    def tell_best(outcome: TrialOutcome) -> None:
        if so_far is not None and so_far.take(outcome) and so_far.best is not None:
            progress.best(so_far.best.condition, so_far.best.value, unit)

    with handled() as interrupts, interrupts.held(), folder.lock(), resumable(folder):
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
            None if experiment.over else tell_best,  # of a part of the settings nothing can be said
        )
        try:
            answer = measure_all(experiment, rig, session, folder, seed, unit, progress)
        except LimitReached:
            folder.journal.append("limit-reached", limit=limit)
            done = counted(session.new_trials, "new trial")
            progress.note(f"stopped after {done}; to continue: {resume_line(folder.path)}")
            return _result(folder, best=None, figure=None, finished=False)
        with interrupts.raising():
            result = finish(folder, answer, progress, draw)
    return require_answer(result, experiment)


def measure_all(
    experiment: Experiment,
    rig: Rig,
    session: Session,
    folder: RunFolder,
    seed: int,
    unit: str,
    progress: Progress,
) -> Answer:
    """Measure all conditions or run the search; return the confirmed best and how the search ended."""
    measures: Measures = session
    settings, goal = settings_of(experiment), experiment.goal
    planner = Planner(experiment, rig, session.motions)
    excess_of = excess_at_settings(planner.excess_of, settings)
    if experiment.over and goal is not None:
        measures = OverSettings(session, settings, experiment.combine, goal[1])

    def best_of(measured: Sequence[Measured], level: Condition) -> Best | None:
        if goal is None:
            return None
        progress.phase("fresh repeats of the leaders")
        guests = [{**guest, **level} for guest in experiment.leaders.guests]
        best = honest_best(
            measures,
            measured,
            objective=goal[0],
            goal=goal[1],
            unit=unit,
            leaders=experiment.leaders,
            guests=guests,
        )
        if best is None:
            return None
        ends = range_end_notes(experiment, best.parameters, excess_of)
        return replace(best, range_ends=ends, combined=combined_text(experiment))

    def expect(trials: int | None) -> None:
        """Announce the number of trials, on the terminal and in the journal."""
        folder.journal.append("expected", sync=False, trials=trials)
        session.expect(trials)

    if experiment.cmaes is not None and experiment.kind == "cmaes":
        expect(most_trials(experiment, ()))

        def guarded(condition: Condition) -> list[Excess]:
            return [*planner.excess_of(condition), *guard_excesses(experiment, session.motions, condition)]

        feasibility = Feasibility(experiment.cmaes, excess_at_settings(guarded, settings))

        def search(level: Condition, number: int) -> Searched:
            return search_by_cmaes(
                experiment, measures, search_folder(folder.path, number),
                feasibility=feasibility, seed=seed, progress=progress, level=level, number=number,
            )  # fmt: skip

        return _best_level(experiment, search, best_of, progress)
    planned = conditions(experiment, seed)
    table = {"run": experiment.run, "track": experiment.track}.get(experiment.kind, experiment.sweep)
    expect(most_trials(experiment, planned))
    order: Literal["shuffled", "as-listed"] = "shuffled" if table is None else table.order
    if goal is None:
        session.measure(at_settings(planned, settings), order=order)
        if experiment.fit is None or experiment.fit.after_run:
            return Answer()
        return Answer(more=(f"next      labrun fit {folder.path.parent.name}",))
    return Answer(best_of(measures.measure(planned, order=order), {}))


def _best_level(
    experiment: Experiment,
    search: Callable[[Condition, int], Searched],
    best_of: Callable[[Sequence[Measured], Condition], Best | None],
    progress: Progress,
) -> Answer:
    """Run one search, or one for each level of a factor, and compare the winners."""
    levels = levels_of(experiment)
    verdicts, winners = [], []
    barren: list[NoCandidateError] = []  # another level may still have candidates that may run
    for number, level in enumerate(levels):
        if level:
            progress.note(f"search {number + 1} of {len(levels)}: {condition_text(level, experiment.units)}")
        try:
            searched = search(level, number)
        except NoCandidateError as error:
            barren.append(error)
            progress.note(str(error))
            continue
        verdicts.append(searched.verdict)
        best = best_of(searched.measured, level)
        if best is not None:
            winners.append((number, best))
    if barren and not verdicts:
        raise barren[0]
    if not winners:
        return Answer(None, tuple(verdicts))
    sign = -1.0 if experiment.goal is not None and experiment.goal[1] == "maximise" else 1.0
    winners.sort(key=lambda item: sign * item[1].value)
    several = tuple(best for _, best in winners) if experiment.each else ()
    return Answer(winners[0][1], tuple(verdicts), several, winners[0][0])


def search_folder(run: Path, number: int) -> Path:
    """Return the folder of a search's generations; the first search uses ``search`` itself."""
    return run / "search" if number == 0 else run / "search" / f"level-{number}"


def source_of(experiment_file: Path) -> dict[str, Any]:
    """Return the path and text of the experiment file, as provenance stores them for `changed_keys`."""
    text = experiment_file.read_text(encoding="utf-8") if experiment_file.is_file() else None
    return {"experiment_file": str(experiment_file.resolve()), "experiment_text": text}


def require_answer(result: RunResult, experiment: Experiment) -> RunResult:
    """Return the result of a finished run; raise ExperimentError if no trial was accepted.

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
        "fix the cause and start a new run",
    )
    error.details.update(result.to_json())
    raise error


def _recorder(experiment: Experiment, rig: Rig, folder: RunFolder, seed: int, progress: Progress) -> Recorder:
    """Return the recorder of the trials: with closed loops, cycle by cycle until a condition, or plain."""
    if experiment.kind == "track":
        from labrun.control import ClosedLoopRecorder

        return ClosedLoopRecorder(experiment, rig)
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
        from labrun.control import ClosedLoopRecorder

        units = {item.name: item.unit for item in ClosedLoopRecorder(experiment, rig).channels}
    return make_objective(name, table).unit(units.get(channel, ""))


def finish(folder: RunFolder, answer: Answer, progress: Progress, draw: bool) -> RunResult:
    """Pack a run, plot it, and store its result."""
    progress.phase("packing run.h5")
    best = answer.best

    def result_with(figure: Path | None) -> RunResult:
        result = _result(folder, best=best, figure=figure, finished=True)
        return replace(result, verdicts=answer.verdicts, winners=answer.winners, more=answer.more)

    result = result_with(None)
    folder.pack()
    figure = _drawn(folder.path, best, progress, answer.search) if draw else None
    record = {
        **result.to_json(),
        "run": folder.path.name,
        "best": None if best is None else best.to_record(),
        **({"winners": [winner.to_record() for winner in answer.winners]} if answer.winners else {}),
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
    return result_with(figure)


def fitted(
    result: RunResult, experiment: Experiment, progress: Progress, workspace: str | Path = "."
) -> RunResult:
    """Fit a finished run if its file requests it, after the bench is released.

    Where that fails the data are safe, and the run counts as done.
    """
    if not result.finished or experiment.fit is None or not experiment.fit.after_run:
        return result
    from labrun.app.fit import fit  # fits, matplotlib

    progress.phase("fitting")
    try:
        with handled() as interrupts, interrupts.raising():
            fit_result = fit(
                result.run, results=result.run.parent.parent, workspace=workspace, note=progress.phase
            )
    except LabrunError as error:
        progress.note(f"the run is kept, and could not be fitted: {error}")
        return result
    except KeyboardInterrupt as error:
        raise Interrupted(
            number_of(error),
            ": the run is finished and kept, its fit is not",
            hint=f"labrun fit {result.run}",
        ) from None
    return replace(result, more=(*result.more, "", fit_result.to_text(), ""))


def draw(folder: Path, best: Best | None, search: int = 0) -> Path | None:
    """Plot a run according to its kind; return None if it has nothing to plot."""
    from labrun.report import run_figure, save_figure  # matplotlib

    with open_run(folder) as run:
        view = RunView(run, experiment_of(run.experiment_toml, run.name), best)
        figure = run_figure(view, read_generations(search_folder(folder, search)))
    return None if figure is None else save_figure(figure, folder / FIGURE)


def _drawn(run: Path, best: Best | None, progress: Progress, search: int = 0) -> Path | None:
    """Plot the run; an error while plotting is reported and does not fail the run."""
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
def interruptible(state: str = " before anything moved or was written") -> Iterator[None]:
    """Raise `Interrupted` when a signal arrives in this block; `state` describes devices and data."""
    with handled() as interrupts:
        try:
            with interrupts.raising():
                yield
        except KeyboardInterrupt as signal:
            raise Interrupted(number_of(signal), state) from None


@contextmanager
def resumable(folder: RunFolder, *, stopped: str = "actuators are stopped, ") -> Iterator[None]:
    """Journal why a run ended early, and print how to resume it."""
    try:
        yield
    except KeyboardInterrupt as signal:  # between two measurements; during one the session sees to it
        interruption = Interrupted(number_of(signal), f": {stopped}{_saved(folder)}", hint=_go_on(folder))
        _journal_end(folder, "interrupted", signal_name(number_of(signal)))
        interruption.details.update(_so_far(folder))
        raise interruption from signal
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
    return f"to continue: {resume_line(folder.path)}"


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
    """Return the run folder and the counts so far, for scripts."""
    try:
        statuses = [outcome.status for outcome in folder.outcomes().values()]
    except (OSError, LabrunError):
        return {"run": str(folder.path)}
    trials = {status: statuses.count(status) for status in ("done", "rejected", "failed")}
    return {"run": str(folder.path), "trials": trials}
