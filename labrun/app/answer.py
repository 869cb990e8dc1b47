"""What a run measures, by its kind, and what that answers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from labrun.devices import Excess
from labrun.runner import Planner, Progress, Rig, Session, guard_excesses
from labrun.search import (
    Best,
    Feasibility,
    Judge,
    Measured,
    Measures,
    NoCandidateError,
    OverSettings,
    Verdict,
    at_settings,
    conditions,
    excess_at_settings,
    honest_best,
    levels_of,
    most_trials,
    search_by_cmaes,
    settings_of,
)
from labrun.spec import Condition, Experiment, condition_text
from labrun.store import RunFolder


@dataclass(frozen=True, slots=True)
class Answer:
    """The honest best, how each search ended, the winner of each level, and which search found the best."""

    best: Best | None = None
    verdicts: tuple[Verdict, ...] = ()
    winners: tuple[Best, ...] = ()
    search: int = 0
    more: tuple[str, ...] = ()
    """Lines that tell more of it."""


def measure_all(
    experiment: Experiment,
    rig: Rig,
    session: Session,
    folder: RunFolder,
    seed: int,
    unit: str,
    progress: Progress,
) -> Answer:
    """Measure what the experiment asks for, name the honest best, and say how a search ended."""
    measures: Measures = session
    settings = settings_of(experiment)
    if experiment.over and experiment.goal is not None:
        measures = OverSettings(session, settings, experiment.combine, experiment.goal[1])
    if experiment.cmaes is not None and experiment.kind == "cmaes":
        _expect(session, folder, most_trials(experiment, ()))
        planner = Planner(experiment, rig, session.motions)

        def guarded(condition: Condition) -> list[Excess]:
            return [*planner.excess_of(condition), *guard_excesses(experiment, session.motions, condition)]

        excess_of = excess_at_settings(guarded, settings)
        feasibility = Feasibility(experiment.cmaes, excess_of)
        return _searched(experiment, measures, feasibility, folder, seed, unit, progress)
    planned = conditions(experiment, seed)
    table = {"run": experiment.run, "track": experiment.track}.get(experiment.kind, experiment.sweep)
    _expect(session, folder, most_trials(experiment, planned))
    order: Literal["shuffled", "as-listed"] = "shuffled" if table is None else table.order
    if experiment.goal is None:
        session.measure(at_settings(planned, settings), order=order)
        return Answer()
    found = measures.measure(planned, order=order)
    return Answer(_best(experiment, measures, found, unit, progress))


def _best(
    experiment: Experiment,
    measures: Measures,
    found: Sequence[Measured],
    unit: str,
    progress: Progress,
    level: Condition | None = None,
) -> Best | None:
    if experiment.goal is None:
        return None
    progress.phase("fresh repeats of the leaders")
    name, direction = experiment.goal
    leaders = experiment.leaders
    guests = [{**guest, **(level or {})} for guest in leaders.guests]
    return honest_best(
        measures, found, objective=name, goal=direction, unit=unit, leaders=leaders, guests=guests
    )


def _searched(
    experiment: Experiment,
    measures: Measures,
    feasibility: Judge,
    folder: RunFolder,
    seed: int,
    unit: str,
    progress: Progress,
) -> Answer:
    """Search, once for each level of a factor if there is one; the winners of the levels are compared."""
    levels = levels_of(experiment)
    verdicts, winners = [], []
    barren: list[NoCandidateError] = []  # another level may still have candidates that may run
    for number, level in enumerate(levels):
        if level:
            progress.note(f"search {number + 1} of {len(levels)}: {condition_text(level, experiment.units)}")
        try:
            searched = search_by_cmaes(
                experiment,
                measures,
                search_folder(folder.path, number),
                feasibility=feasibility,
                seed=seed,
                progress=progress,
                level=level,
                number=number,
            )
        except NoCandidateError as error:
            barren.append(error)
            progress.note(str(error))
            continue
        verdicts.append(searched.verdict)
        best = _best(experiment, measures, searched.found, unit, progress, level)
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
    """Return where the generations of a search stand: of the first one, or the only one, in ``search`` itself."""
    return run / "search" if number == 0 else run / "search" / f"level-{number}"


def _expect(session: Session, folder: RunFolder, trials: int | None) -> None:
    """Say how many trials there will be, here and to whoever watches the run from elsewhere."""
    folder.journal.append("expected", sync=False, trials=trials)
    session.expect(trials)
