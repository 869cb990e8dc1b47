"""From data and a model to the next experiment."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labrun.fit import Dataset, Note, silent
from labrun.gap import criteria
from labrun.gap.diagnose import Question
from labrun.gap.next.proposal import (
    Outcome,
    Outlook,
    Proposal,
    experiment_text,
    free_place,
    spoken,
    told,
    would_separate,
    write_experiment,
    write_recording_plan,
)
from labrun.gap.next.recording_bench import RecordingBench
from labrun.gap.next.run_bench import RunBench
from labrun.gap.next.separation import Evidence, Rivals, Separation, predict, rehearse, rivals_of
from labrun.gap.next.trials import PlannedTrial
from labrun.gap.pipeline import Search, search_causes
from labrun.store import imported_channels, open_run


@dataclass(frozen=True)
class Choice:
    """Trials of a pool.

    Attributes
    ----------
    trials
        Indices into `Separation.trials`.
    evidence
        Pair by pair.
    """

    trials: tuple[int, ...]
    evidence: tuple[Evidence, ...]


def choose(separation: Separation, enough: float = criteria.ENOUGH_EVIDENCE) -> Choice:
    """Return a few trials; the cheapest way first, and whatever separates best if that does not decide.

    Parameters
    ----------
    enough
        Evidence of every pair, over what a diagnosis asks for, at which no further trial is taken in.
    """
    if not separation.trials:
        return Choice((), tuple(separation.evidence(())))
    aim = _Aim.of(separation, enough)
    cheap = _greedy(separation, aim, dear=1.0)
    if aim.least(cheap.evidence) >= criteria.TOLD_APART:
        return cheap
    best = _greedy(separation, aim, dear=0.0)
    return best if aim.value(best.evidence) > aim.value(cheap.evidence) else cheap


@dataclass(frozen=True)
class _Aim:
    """What counts: the pairs that any trials of the pool can separate, each up to `enough`."""

    pairs: tuple[int, ...]
    enough: float

    @classmethod
    def of(cls, separation: Separation, enough: float) -> "_Aim":
        alone = [separation.evidence([k]) for k in range(len(separation.trials))]
        alone.append(separation.evidence(range(len(separation.trials))))
        most = [max(looks[pair].ratio for looks in alone) for pair in range(len(alone[0]))]
        hopeful = tuple(pair for pair, ratio in enumerate(most) if ratio >= criteria.HOPELESS_EVIDENCE)
        return cls(hopeful or tuple(range(len(most))), enough)

    def value(self, evidence: Sequence[Evidence]) -> float:
        """Return the evidence of all pairs; what one has beyond enough does not make up for another."""
        ratios = [min(max(evidence[pair].ratio, -1.0), self.enough) for pair in self.pairs]
        return sum(ratios) + len(ratios) * min(ratios)

    def least(self, evidence: Sequence[Evidence]) -> float:
        """Return the evidence of the pair that is told apart worst."""
        return min(evidence[pair].ratio for pair in self.pairs)


def _greedy(separation: Separation, aim: _Aim, dear: float) -> Choice:
    """Add the trial that raises the evidence most for its time (to the power `dear`), until there is enough."""
    chosen: list[int] = []
    value = aim.value(separation.evidence(chosen))
    doubt = [separation.doubt(k) for k in range(len(separation.trials))]
    while len(chosen) < min(criteria.NEXT_TRIALS[1], len(separation.trials)):
        rest = [k for k in range(len(separation.trials)) if k not in chosen]
        gains = [aim.value(separation.evidence([*chosen, k])) - value for k in rest]
        worth = [
            gain / (doubt[k] * separation.trials[k].cost_s ** dear)
            for gain, k in zip(gains, rest, strict=True)
        ]
        at = int(np.argmax(worth))
        if len(chosen) >= criteria.NEXT_TRIALS[0] and gains[at] <= 0.02 * max(value, 1e-12):
            break
        chosen.append(rest[at])
        value += gains[at]
        if len(chosen) >= criteria.NEXT_TRIALS[0] and aim.least(separation.evidence(chosen)) >= aim.enough:
            break
    return Choice(tuple(chosen), tuple(separation.evidence(chosen)))


@dataclass(frozen=True)
class ProposedTrials:
    """Chosen trials and what to expect of them, before anything is written."""

    trials: tuple[PlannedTrial, ...]
    evidence: tuple[Evidence, ...]
    rivals: Rivals

    @property
    def outcome(self) -> Outcome:
        """What to expect."""
        if not self.trials or all(
            one.sigma < criteria.VISIBLE_DIFFERENCE or one.ratio < criteria.HOPELESS_EVIDENCE
            for one in self.evidence
        ):
            return "cannot"
        return "separates" if self.decided == len(self.evidence) else "helps"

    @property
    def decided(self) -> int:
        """How many of the pairs a diagnosis of everything would decide."""
        return sum(one.ratio >= criteria.TOLD_APART for one in self.evidence)


def propose(
    target: Path,
    question: Question,
    *,
    model: str | Path | None = None,
    out: Path | None = None,
    seed: int = 0,
    workspace: Path = Path(),
    note: Note = silent,
) -> Proposal:
    """Propose the trials that best separate what a diagnosis leaves, inside the rig's limits, and write them down.

    Parameters
    ----------
    target
        The recording folder, run folder or run.h5 that the question is about.
    question
        Its data, and the model they are held against.
    model
        How that model was named, if it was; the experiment that is written names it, too.
    workspace
        Where the person works.
    out
        The file to write: an experiment for a run, a recording's toml (with the inputs as CSV files beside it) for a
        recording. If None, ``experiments/<name>-next.toml`` or ``<name>-next/recording.toml`` in the workspace.
    seed
        Of the search and of the pool of trials.

    Raises
    ------
    LabrunError
        Data or a model that do not allow a diagnosis; a rig whose motion cannot be planned; a file that is there.
    """
    rng = np.random.default_rng(seed)
    search = search_causes(question.dataset, question.model, rng, note=note)
    if question.dataset.kind == "recording" or _was_imported(target):
        return _for_recording(question, search, out, workspace, note)
    return _for_run(target, model, question, search, out, workspace, rng, note)


def _was_imported(target: Path) -> bool:

    return bool(imported_channels(open_run(target).experiment_toml))


def design(
    search: Search, dataset: Dataset, pool: Sequence[PlannedTrial], note: Note = silent
) -> ProposedTrials:
    """Choose from a pool the trials that best separate what a search leaves."""
    rivals = rivals_of(search)
    note(f"comparing {len(pool)} trials for {len(rivals.rivals)} explanations")
    separation = Separation(rivals, dataset, pool, criteria.NEXT_REPEATS)
    best: ProposedTrials | None = None
    for enough in criteria.EVIDENCE_AIMED_AT:
        choice = choose(separation, enough)
        trials = tuple(separation.trials[k] for k in choice.trials)
        if not trials or all(
            one.sigma < criteria.VISIBLE_DIFFERENCE or one.ratio < criteria.HOPELESS_EVIDENCE
            for one in choice.evidence
        ):
            return ProposedTrials((), choice.evidence, rivals)
        if best is not None and trials == best.trials:
            break
        note("fitting every explanation to what the others predict for the chosen trials")
        fitted = rehearse(rivals, dataset, trials, criteria.NEXT_REPEATS)
        # a fit that lost its way leaves more than the first order does: the lesser of the two is to be believed
        pairs = zip(choice.evidence, fitted, strict=True)
        found = ProposedTrials(trials, tuple(min(both, key=lambda one: one.ratio) for both in pairs), rivals)
        if best is None or found.decided > best.decided:
            best = found
        if found.decided == len(found.evidence):
            break
    return best if best is not None else ProposedTrials((), (), rivals)


def inside(search: Search, dataset: Dataset, pool: Sequence[PlannedTrial]) -> list[PlannedTrial]:
    """Return the trials in which no output is predicted to leave the recorded range by more than a fifth."""
    measured = np.concatenate([trial.outputs for trial in dataset.trials])
    middle = 0.5 * (measured.max(axis=0) + measured.min(axis=0))
    half = 0.5 * np.ptp(measured, axis=0)
    predicted = predict(rivals_of(search).rivals[0], dataset, pool)
    return [
        trial
        for trial, outputs in zip(pool, predicted, strict=True)
        if outputs is not None and np.all(np.abs(outputs - middle) <= criteria.ROOM_OF_OUTPUTS * half)
    ]


def _for_recording(
    question: Question, search: Search, out: Path | None, workspace: Path, note: Note
) -> Proposal:
    dataset = question.dataset
    bench = RecordingBench(search.data, question.model, criteria.NEXT_REPEATS)
    found = design(search, dataset, inside(search, dataset, bench.pool()), note)
    notes = [
        "The recording does not say what its rig allows: every input stays within the range it was recorded in; "
        "check speeds and resets yourself. The time is that of recording alone.",
        *_by_hand(bench.set_by_hand, found.trials, question.dataset),
    ]
    time_s = sum(trial.cost_s for trial in found.trials)
    file = None
    commands: list[str] = []
    if found.outcome != "cannot":
        file = out or free_place(workspace, f"{dataset.name}-next", "recording.toml")
        write_recording_plan(
            file,
            f"{dataset.name}-next",
            dataset,
            found.trials,
            criteria.NEXT_REPEATS,
            _remarks(found, time_s),
        )
        commands = [f"labrun gap diagnose {dataset.source} --with {file.parent}"]
    return _proposal(found, file, time_s, time_s, notes, commands)


def _for_run(
    target: Path,
    model: str | Path | None,
    question: Question,
    search: Search,
    out: Path | None,
    workspace: Path,
    rng: np.random.Generator,
    note: Note,
) -> Proposal:

    run = open_run(target)
    dataset = question.dataset
    bench = RunBench.of(run, dataset, question.model, question.signals, criteria.NEXT_REPEATS)
    note("looking what the rig allows")
    found = design(search, dataset, bench.pool(rng), note)
    notes = _by_hand(bench.set_by_hand, found.trials, dataset)
    if bench.stands_in:
        names = ", ".join(bench.stands_in)
        notes.append(f"The commanded motion was taken for what {names} will measure.")
    file, commands = None, list[str]()
    time_s = time_at_most_s = 0.0
    if found.outcome != "cannot":
        plan = bench.plan(found.trials)
        time_s, time_at_most_s = bench.time_s(plan), max(plan.time_at_most_s, bench.time_s(plan))
        file = out or free_place(workspace / "experiments", f"{run.name}-next")
        text = experiment_text(
            bench, found.trials, _remarks(found, time_s), None if model is None else _model_name(model, file)
        )
        write_experiment(file, text)
        commands = [
            f"labrun run {_shown(file)}",
            f"labrun gap diagnose {run.name} --with {file.stem}",
        ]
    return _proposal(found, file, time_s, time_at_most_s, notes, commands)


def _proposal(
    found: ProposedTrials,
    file: Path | None,
    time_s: float,
    time_at_most_s: float,
    notes: Sequence[str],
    commands: Sequence[str],
) -> Proposal:
    rivals = found.rivals
    open_pairs = [pair for pair, one in zip(rivals.pairs, found.evidence, strict=True) if one.ratio < 1.0]
    once = {frozenset((one.name, other.name)): (one, other) for one, other in open_pairs}
    advice = tuple(would_separate(*pair) for pair in once.values())
    return Proposal(
        found.outcome, file, tuple(one.name for one in rivals.rivals), tuple(one.cause for one in rivals.rivals),
        rivals.doubt, rivals.why, found.trials, criteria.NEXT_REPEATS, time_s, time_at_most_s, _outlook(found), advice,
        tuple(notes), tuple(commands),
    )  # fmt: skip


def _outlook(found: ProposedTrials) -> tuple[Outlook, ...]:
    return tuple(
        Outlook(truth.name, other.name, one.sigma, one.ratio)
        for (truth, other), one in zip(found.rivals.pairs, found.evidence, strict=True)
    )


def _remarks(found: ProposedTrials, time_s: float) -> list[str]:
    """Return the head of the file: what it is for."""
    lines = [found.rivals.why, f"Rig time of these trials: about {spoken(time_s)}. What to expect:"]
    return [*lines, *(f"  {line}" for line in told(_outlook(found)))]


def _by_hand(names: Sequence[str], trials: Sequence[PlannedTrial], dataset: Dataset) -> list[str]:
    """Return a sentence on what changes that no motion changes."""
    every = [*(one.condition for one in dataset.trials), *(one.condition for one in trials)]
    changed = [name for name in names if trials and len({one.get(name) for one in every}) > 1]
    if not changed:
        return []
    *most, last = sorted(changed)
    listed = f"{', '.join(most)} and {last}" if most else last
    return [f"Somebody at the bench sets {listed}, which takes its own time: no motion does."]


def _model_name(model: str | Path, file: Path) -> str:
    """Return how the experiment file names a model file: from its own folder, so that both can be moved together."""
    path = Path(model)
    return Path(os.path.relpath(path, file.parent)).as_posix() if path.is_file() else str(model)


def _shown(file: Path) -> str:
    return file.stem if file.parent.name == "experiments" else str(file)
