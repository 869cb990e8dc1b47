"""What `labrun gap next` proposes: trials that best separate what a diagnosis leaves, and what to expect of them."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from labrun.fit import Dataset, Note, silent
from labrun.gap import criteria
from labrun.gap.diagnose import Question
from labrun.gap.diagnosis import Name
from labrun.gap.next.recording_bench import RecordingBench
from labrun.gap.next.rivals import Rival, Rivals, rivals_of
from labrun.gap.next.run_bench import RunBench
from labrun.gap.next.separation import Evidence, Separation, hopeless, predict
from labrun.gap.next.trials import NEXT_REPEATS, PlannedTrial, free_place
from labrun.gap.pipeline import Search, search_causes
from labrun.notebook import as_html
from labrun.store import imported_channels, open_run, require_writable

_ROOM_OF_OUTPUTS = 1.2
"""How far beyond the recorded range of an output a planned recording may be predicted to go."""

Outcome = Literal["separates", "helps", "cannot"]


@dataclass(frozen=True)
class Proposal:
    """The next experiment.

    Attributes
    ----------
    outcome
        "separates": all are expected to be told apart; "helps": only some, or not surely; "cannot": nothing inside the
        limits does.
    file
        What was written; None where there is nothing to run.
    rivals
        What is to be told apart, most probable first; `names` the same for scripts, None for the recalibrated model.
    doubt
        Whether the diagnosis itself was in doubt between them.
    trials, repeats
        Conditions or courses of the inputs, and how often each.
    time_s
        Rig time of all of it; `time_at_most_s` if every settling takes until its timeout.
    outlook
        Pair by pair.
    advice
        What would separate those that this does not.
    commands
        What to type next.
    """

    outcome: Outcome
    file: Path | None
    rivals: tuple[str, ...]
    names: tuple[Name | None, ...]
    doubt: bool
    why: str
    trials: tuple[PlannedTrial, ...]
    repeats: int
    time_s: float
    time_at_most_s: float
    outlook: tuple[Evidence, ...]
    advice: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()

    @property
    def sigma(self) -> float:
        """Of the pair that is told apart worst; what the simpler one decides without a difference is left out."""
        worst = [evidence.sigma for evidence in self.outlook if not evidence.by_simplicity]
        return min(worst, default=0.0)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap next --json`` prints."""
        return {
            "outcome": self.outcome,
            "file": None if self.file is None else str(self.file),
            "rivals": [
                {"name": text, "cause": None if name is None else name.to_json()}
                for text, name in zip(self.rivals, self.names, strict=True)
            ],
            "in_doubt": self.doubt,
            "why": self.why,
            "trials": [
                {
                    "label": trial.label,
                    "condition": dict(trial.condition),
                    "duration_s": float(trial.time_s[-1] - trial.time_s[0]),
                    "rig_time_s": trial.cost_s,
                }
                for trial in self.trials
            ],
            "repeats": self.repeats,
            "time_s": self.time_s,
            "time_at_most_s": self.time_at_most_s,
            "expected": [
                {
                    "truth": evidence.truth,
                    "rival": evidence.rival,
                    "sigma": evidence.sigma,
                    "over_threshold": evidence.ratio,
                }
                for evidence in self.outlook
            ],
            "sigma": self.sigma,
            "advice": list(self.advice),
            "notes": list(self.notes),
            "commands": list(self.commands),
        }

    def _repr_html_(self) -> str:
        return as_html(self.to_text())

    @property
    def _words(self) -> dict[str, str]:
        """What each rival is called for people."""
        return {
            text: text if name is None else name.words
            for text, name in zip(self.rivals, self.names, strict=True)
        }

    def to_text(self) -> str:
        """Return what a person reads."""
        lines = [self.why]
        if self.trials and self.outcome != "cannot":
            lines.append(
                f"{len(self.trials)} trials, {self.repeats} repeats each, about {spoken(self.time_s)}:"
            )
            lines += [f"  {trial.label}" for trial in self.trials]
        lines += _sentences(self.outlook, self._words)
        lines.append(self.conclusion)
        lines += self.advice
        lines += self.notes
        if self.file is not None:
            lines.append(f"written: {self.file}")
        lines += [f"  {command}" for command in self.commands]
        return "\n".join(lines)

    @property
    def conclusion(self) -> str:
        """What to expect, as a sentence."""
        if self.outcome == "separates":
            return f"Expected to tell them apart, at {_number(self.sigma)} standard deviations or more."
        if self.outcome == "helps":
            return "It narrows the question down, but is not expected to settle all of it."
        return "Nothing that this rig can do inside its limits tells them apart."


def spoken(seconds: float) -> str:
    """Return a time as a person says it: "40 s", "12 min", "2 h 5 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = math.ceil(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


def _sentences(outlook: Sequence[Evidence], words: Mapping[str, str]) -> list[str]:
    """Return a sentence for every two explanations, the worse of the two ways round, in their words for people."""
    worst: dict[frozenset[str], Evidence] = {}
    for evidence in outlook:
        pair = frozenset((evidence.truth, evidence.rival))
        worst[pair] = min(worst.get(pair, evidence), evidence, key=lambda each: (each.told_apart, each.sigma))
    return [_sentence(evidence, words[evidence.truth], words[evidence.rival]) for evidence in worst.values()]


def _sentence(evidence: Evidence, truth: str, rival: str) -> str:
    if evidence.by_simplicity:
        return f"if it is {truth}, {rival} can do the same with more parameters: the simpler is named"
    sigma = _number(evidence.sigma)
    if evidence.told_apart:
        return f"{truth} or {rival}: told apart, at {sigma} standard deviations"
    if evidence.sigma < criteria.VISIBLE_DIFFERENCE:
        return f"{truth} or {rival}: not told apart, they predict the same"
    return f"{truth} or {rival}: {sigma} standard deviations, too few conditions or too small a difference for the rule"


def _number(sigma: float) -> str:
    return f"{sigma:.0f}" if sigma >= 10 else f"{sigma:.1f}"


_LATE = frozenset({"delay", "lag"})
_OFFSET = frozenset({"constant-force", "rest-offset", "bias"})
_DRY = frozenset({"coulomb-friction", "stribeck-friction", "presliding-friction"})
_SIDED = frozenset({"asymmetric-friction", "asymmetric-stiffness", "constant-force"})
_TILT = frozenset({"tilt", "tilt_rad", "tilt_deg"})
"""What a model calls the parameter that says how its bench stands."""
_MASS = frozenset({"added-inertia", "added-mass"})
_FAST = frozenset({"viscous-damping", "quadratic-drag", "drag-error", "reynolds-dependent-drag"})
_STIFF = frozenset({"cubic-stiffness", "asymmetric-stiffness", "end-stop", "backlash"})

_HARDLY = "More repeats, or larger motion: what is left of the gap is hardly beyond the noise."
_OTHERWISE = (
    "A further sensor between the two, or motion over a wider range of amplitude and frequency than was allowed "
    "here."
)
_CONTAINED = "The richer friction contains the simpler one, and at the sizes found they are the same:"


_RULES: tuple[tuple[frozenset[str], frozenset[str], str], ...] = (
    (
        frozenset({"delay"}),
        frozenset({"lag"}),
        "Excite faster: a delay and a lag part past 1/(2 pi tau){corner}.",
    ),
    (
        frozenset({"load-dependent-friction"}),
        _DRY | {"viscous-damping"},
        "Load the joint differently: a second mass, as a condition that the model uses, changes friction that depends "
        "on the load and leaves the other as it is.",
    ),
    (
        frozenset({"coulomb-friction"}),
        frozenset({"stribeck-friction", "presliding-friction"}),
        f"{_CONTAINED} only slower motion, and reversals, could show a difference.",
    ),
    (
        frozenset({"constant-force"}),
        frozenset({"rest-offset"}),
        "A constant force and a displaced rest position are the same in a joint of one stiffness: exchange its spring, "
        "or turn it over against gravity.",
    ),
    (
        _OFFSET,
        _OFFSET,
        "Change what holds the joint (its spring, its load, its orientation to gravity): a force moves it by another "
        "angle then, a sensor's bias stays; a second sensor tells the bias of the first.",
    ),
    (
        frozenset({"asymmetric-friction"}),
        frozenset({"coulomb-friction"}),
        f"{_CONTAINED} only the same course with its sign turned round, often, could show a difference.",
    ),
    (
        frozenset({"asymmetric-friction"}),
        _DRY | _FAST | {"load-dependent-friction", "hysteresis"},
        "Drive it both ways alike, by the same course and that course with its sign turned round: what resists both "
        "directions alike gives mirror images, friction with a level for each does not.",
    ),
    (
        _SIDED,
        _DRY | _SIDED | _OFFSET | _TILT,
        "Measure at two orientations of gravity: what comes from the bench's tilt changes sides, what belongs to the "
        "joint does not.",
    ),
    (
        _MASS,
        _FAST | _STIFF | _LATE,
        "Vary the frequency at the same amplitude: inertia grows with its square, the other does not.",
    ),
    (
        _FAST | _STIFF | _DRY,
        _FAST | _STIFF | _DRY,
        "Vary the amplitude over a wide range, at one frequency: the two grow with different powers of it.",
    ),
)
"""Advice for a pair with one effect in each of two sets; the first that fits."""


def would_separate(rival: Rival, other: Rival) -> str:
    """Return, as a sentence that names both, what kind of trial or bench tells two causes apart."""
    return f"{rival.words} or {other.words}: {_advice(rival, other)}"


def _advice(rival: Rival, other: Rival) -> str:
    if rival.cause is None or other.cause is None:
        return _HARDLY
    effect, other_effect = rival.cause.effect, other.cause.effect
    if effect == other_effect:
        return _OTHERWISE
    for some, others, advice in _RULES:
        if (effect in some and other_effect in others) or (other_effect in some and effect in others):
            return advice.format(corner=_corner(rival, other))
    return _OTHERWISE


def _corner(*rivals: Rival) -> str:
    """Return the corner frequency of a lag among the rivals, as fitted."""
    for rival in rivals:
        taus = list(rival.sizes.values())
        if rival.cause is not None and rival.cause.effect == "lag" and taus and taus[0] > 0:
            return f" = {1.0 / (2.0 * math.pi * taus[0]):.3g} Hz"
    return ""


@dataclass(frozen=True)
class ProposedTrials:
    """Chosen trials and what to expect of them, before anything is written."""

    trials: tuple[PlannedTrial, ...]
    evidence: tuple[Evidence, ...]
    rivals: Rivals

    @property
    def outcome(self) -> Outcome:
        """What to expect."""
        if not self.trials or hopeless(self.evidence):
            return "cannot"
        return "separates" if self.decided == len(self.evidence) else "helps"

    @property
    def decided(self) -> int:
        """How many of the pairs a diagnosis of everything would decide."""
        return sum(evidence.told_apart for evidence in self.evidence)


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
        Data or a model that do not allow a diagnosis; a rig whose motion cannot be planned; a file that is there, or
        that cannot be written.
    """
    rng = np.random.default_rng(seed)
    dataset, repeats = question.dataset, NEXT_REPEATS
    run = None if dataset.kind == "recording" else open_run(target)
    if run is None or imported_channels(run.experiment_toml):
        file = out or free_place(workspace, f"{dataset.name}-next", "recording.toml")
        require_writable(file.parent, file.name)
        search = search_causes(dataset, question.model, rng, note=note)
        recording = RecordingBench(search.data, question.model, repeats)
        designed = design(search, dataset, inside(search, dataset, recording.pool()), note)
        time_s = time_at_most_s = sum(trial.cost_s for trial in designed.trials)
        notes = [
            "The recording does not say what its rig allows: every input stays within the range it was recorded in; "
            "check speeds and resets yourself. The time is that of recording alone.",
            *_by_hand(recording.set_by_hand, designed.trials, dataset),
        ]
        commands = [f"labrun gap diagnose {dataset.source} --with {file.parent}"]
        if designed.outcome != "cannot":
            recording.write(
                file, f"{dataset.name}-next", dataset, designed.trials, _remarks(designed, time_s)
            )
        return _proposal(designed, file, (time_s, time_at_most_s), notes, commands)
    file = out or free_place(workspace / "experiments", f"{run.name}-next")
    require_writable(file.parent, file.name)
    search = search_causes(dataset, question.model, rng, note=note)
    bench = RunBench.of(run, dataset, question.model, question.signals, repeats)
    note("looking what the rig allows")
    designed = design(search, dataset, bench.pool(rng), note)
    notes = _by_hand(bench.set_by_hand, designed.trials, dataset)
    if bench.stands_in:
        names = ", ".join(bench.stands_in)
        notes.append(f"The commanded motion was taken for what {names} will measure.")
    if designed.outcome == "cannot":
        return _proposal(designed, None, (0.0, 0.0), notes, [])
    plan = bench.plan(designed.trials)
    time_s = bench.time_s(plan)
    named = None if model is None else _model_name(model, file)
    bench.write(file, designed.trials, _remarks(designed, time_s), named)
    shown = file.stem if file.parent.name == "experiments" else str(file)
    commands = [f"labrun run {shown}", f"labrun gap diagnose {run.name} --with {file.stem}"]
    return _proposal(designed, file, (time_s, max(plan.time_at_most_s, time_s)), notes, commands)


def design(
    search: Search, dataset: Dataset, pool: Sequence[PlannedTrial], note: Note = silent
) -> ProposedTrials:
    """Choose from a pool the trials that best separate what a search leaves."""
    rivals = rivals_of(search)
    note(f"comparing {len(pool)} trials for {len(rivals.rivals)} explanations")
    separation = Separation(rivals, dataset, pool, NEXT_REPEATS)
    chosen = separation.choose()
    evidence = tuple(separation.evidence(chosen))
    if not chosen or hopeless(evidence):
        return ProposedTrials((), evidence, rivals)
    return ProposedTrials(tuple(separation.trials[k] for k in chosen), evidence, rivals)


def inside(search: Search, dataset: Dataset, pool: Sequence[PlannedTrial]) -> list[PlannedTrial]:
    """Return the trials in which no output is predicted to leave the recorded range by more than a fifth."""
    measured = np.concatenate([trial.outputs for trial in dataset.trials])
    middle = 0.5 * (measured.max(axis=0) + measured.min(axis=0))
    half = 0.5 * np.ptp(measured, axis=0)
    predicted = predict(rivals_of(search).rivals[0], dataset, pool)
    return [
        trial
        for trial, outputs in zip(pool, predicted, strict=True)
        if outputs is not None and np.all(np.abs(outputs - middle) <= _ROOM_OF_OUTPUTS * half)
    ]


def _proposal(
    trials: ProposedTrials,
    file: Path | None,
    times_s: tuple[float, float],
    notes: Sequence[str],
    commands: Sequence[str],
) -> Proposal:
    rivals, nothing = trials.rivals, trials.outcome == "cannot"
    unsettled = [
        pair for pair, evidence in zip(rivals.pairs, trials.evidence, strict=True) if evidence.ratio < 1.0
    ]
    once = {frozenset((first.name, other.name)): (first, other) for first, other in unsettled}
    return Proposal(
        trials.outcome,
        None if nothing else file,
        tuple(rival.name for rival in rivals.rivals),
        tuple(rival.cause for rival in rivals.rivals),
        rivals.doubt,
        rivals.why,
        trials.trials,
        NEXT_REPEATS,
        *times_s,
        trials.evidence,
        tuple(would_separate(*pair) for pair in once.values()),
        tuple(notes),
        () if nothing else tuple(commands),
    )


def _remarks(trials: ProposedTrials, time_s: float) -> list[str]:
    """Return the head of the file: what it is for."""
    words = {rival.name: rival.words for rival in trials.rivals.rivals}
    lines = [trials.rivals.why, f"Rig time of these trials: about {spoken(time_s)}. What to expect:"]
    return [*lines, *(f"  {line}" for line in _sentences(trials.evidence, words))]


def _by_hand(names: Sequence[str], trials: Sequence[PlannedTrial], dataset: Dataset) -> list[str]:
    """Return a sentence on what changes that no motion changes."""
    every = [*(trial.condition for trial in dataset.trials), *(trial.condition for trial in trials)]
    changed = [name for name in names if trials and len({condition.get(name) for condition in every}) > 1]
    if not changed:
        return []
    *most, last = sorted(changed)
    listed = f"{', '.join(most)} and {last}" if most else last
    return [f"Somebody at the bench sets {listed}, which takes its own time: no motion does."]


def _model_name(model: str | Path, file: Path) -> str:
    """Return how the experiment file names a model file: from its own folder, so that both can be moved together."""
    path = Path(model)
    return Path(os.path.relpath(path, file.parent)).as_posix() if path.is_file() else str(model)
