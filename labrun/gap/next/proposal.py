"""What `labrun gap next` answers, in words, numbers and files: which trials, what they would tell apart."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w

from labrun.errors import RequestError
from labrun.fit import Dataset
from labrun.gap import criteria
from labrun.gap.diagnosis import Name
from labrun.gap.next.run_bench import RunBench
from labrun.gap.next.separation import Rival
from labrun.gap.next.trials import PlannedTrial
from labrun.spec import load_experiment

Outcome = Literal["separates", "helps", "cannot"]


@dataclass(frozen=True, slots=True)
class Outlook:
    """What the trials would say of two explanations, if the first is true.

    Attributes
    ----------
    sigma
        Standard deviations by which the wrong one, fitted to everything, would miss.
    ratio
        Log likelihood over what a diagnosis asks for before it drops the wrong one. Above 1 it names the right one
        alone if sizes and parameters are what they were fitted to be; `SURE` leaves room for their errors.
    """

    truth: str
    rival: str
    sigma: float
    ratio: float

    @property
    def by_simplicity(self) -> bool:
        """Whether the rival would explain it as well, and is dropped for having more parameters."""
        return self.ratio >= criteria.TOLD_APART and self.sigma < criteria.CLEARLY_SEEN


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
        Pair by pair, refitted.
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
    outlook: tuple[Outlook, ...]
    advice: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()

    @property
    def sigma(self) -> float:
        """Of the pair that is told apart worst; what the simpler one decides without a difference is left out."""
        worst = [one.sigma for one in self.outlook if not one.by_simplicity]
        return min(worst, default=0.0)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap next --json`` prints."""
        return {
            "outcome": self.outcome,
            "file": None if self.file is None else str(self.file),
            "rivals": [
                {"name": text, "cause": None}
                if name is None
                else {"name": text, "cause": {"kind": name.kind, "effect": name.effect, "site": name.site}}
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
                {"truth": one.truth, "rival": one.rival, "sigma": one.sigma, "over_threshold": one.ratio}
                for one in self.outlook
            ],
            "sigma": self.sigma,
            "advice": list(self.advice),
            "notes": list(self.notes),
            "commands": list(self.commands),
        }

    def to_text(self) -> str:
        """Return what a person reads."""
        lines = [self.why]
        if self.trials and self.outcome != "cannot":
            lines.append(
                f"{len(self.trials)} trials, {self.repeats} repeats each, about {spoken(self.time_s)}:"
            )
            lines += [f"  {trial.label}" for trial in self.trials]
        lines += told(self.outlook)
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


def told(outlook: Sequence[Outlook]) -> list[str]:
    """Return a sentence for every two explanations, the worse of the two ways round."""
    worst: dict[frozenset[str], Outlook] = {}
    for one in outlook:
        pair = frozenset((one.truth, one.rival))
        known = worst.get(pair)
        if known is None or (one.ratio >= criteria.TOLD_APART, one.sigma) < (
            known.ratio >= criteria.TOLD_APART,
            known.sigma,
        ):
            worst[pair] = one
    return [_told(one) for one in worst.values()]


def _told(one: Outlook) -> str:
    if one.by_simplicity:
        return f"if it is {one.truth}, {one.rival} can do the same with more parameters: the simpler is named"
    if one.ratio >= criteria.TOLD_APART:
        return f"{one.truth} or {one.rival}: told apart, at {_number(one.sigma)} standard deviations"
    if one.sigma < criteria.CLEARLY_SEEN:
        return f"{one.truth} or {one.rival}: not told apart, they predict the same"
    return f"{one.truth} or {one.rival}: {_number(one.sigma)} standard deviations, too few for what the effect shows"


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
    "A further sensor between the two, or motion over a wider range of amplitude and frequency than was "
    "allowed here."
)


@dataclass(frozen=True, slots=True)
class _Rule:
    """Advice for a pair with one effect in each of two sets."""

    one: frozenset[str]
    other: frozenset[str]
    advice: str


_RULES = (
    _Rule(
        frozenset({"delay"}),
        frozenset({"lag"}),
        "Excite faster: a delay and a lag part past 1/(2 pi tau){corner}.",
    ),
    _Rule(
        frozenset({"load-dependent-friction"}),
        _DRY | {"viscous-damping"},
        "Load the joint differently: a second mass, as a condition that the "
        "model uses, changes friction that depends on "
        "the load and leaves the other as it is.",
    ),
    _Rule(
        frozenset({"coulomb-friction"}),
        frozenset({"stribeck-friction", "presliding-friction"}),
        "The richer friction contains the simpler one, and at the sizes found "
        "they are the same: only slower motion, and "
        "reversals, could show a difference.",
    ),
    _Rule(
        frozenset({"constant-force"}),
        frozenset({"rest-offset"}),
        "A constant force and a displaced rest position are the same in a "
        "joint of one stiffness: exchange its spring, or "
        "turn it over against gravity.",
    ),
    _Rule(
        _OFFSET,
        _OFFSET,
        "Change what holds the joint (its spring, its load, its orientation to gravity): a force moves it by another "
        "angle then, a sensor's bias stays; a second sensor tells the bias of the first.",
    ),
    _Rule(
        frozenset({"asymmetric-friction"}),
        frozenset({"coulomb-friction"}),
        "The richer friction contains the simpler one, and at the sizes found they are the same: only the same course "
        "with its sign turned round, often, could show a difference.",
    ),
    _Rule(
        frozenset({"asymmetric-friction"}),
        _DRY | _FAST | frozenset({"load-dependent-friction", "hysteresis"}),
        "Drive it both ways alike, by the same course and that course with its sign turned round: what resists both "
        "directions alike gives mirror images, friction with a level for each does not.",
    ),
    _Rule(
        _SIDED,
        _DRY | _SIDED | _OFFSET | _TILT,
        "Measure at two orientations of gravity: what comes from the bench's "
        "tilt changes sides, what belongs to the joint "
        "does not.",
    ),
    _Rule(
        _MASS,
        _FAST | _STIFF | _LATE,
        "Vary the frequency at the same amplitude: inertia grows with its square, the other does not.",
    ),
    _Rule(
        _FAST | _STIFF | _DRY,
        _FAST | _STIFF | _DRY,
        "Vary the amplitude over a wide range, at one frequency: the two grow with different powers of it.",
    ),
)


def would_separate(one: Rival, other: Rival) -> str:
    """Return, as a sentence that names both, what kind of trial or bench tells two causes apart."""
    return f"{one.name} or {other.name}: {_advice(one, other)}"


def _advice(one: Rival, other: Rival) -> str:
    if one.cause is None or other.cause is None:
        return _HARDLY
    here, there = one.cause.effect, other.cause.effect
    if here == there:
        return _OTHERWISE
    for rule in _RULES:
        if (here in rule.one and there in rule.other) or (there in rule.one and here in rule.other):
            return rule.advice.format(corner=_corner(one, other))
    return _OTHERWISE


def _corner(*rivals: Rival) -> str:
    """Return the corner frequency of a lag among the rivals, as fitted."""
    for rival in rivals:
        taus = list(rival.sizes.values())
        if rival.cause is not None and rival.cause.effect == "lag" and taus and taus[0] > 0:
            return f" = {1.0 / (2.0 * math.pi * taus[0]):.3g} Hz"
    return ""


def free_place(folder: Path, stem: str, name: str = "") -> Path:
    """Return a path in a folder that is not taken: ``stem.toml``, ``stem-2.toml`` ...; or a folder's file `name`."""
    for number in range(1, 1000):
        numbered = stem if number == 1 else f"{stem}-{number}"
        path = folder / numbered / name if name else folder / f"{numbered}.toml"
        if not path.exists():
            return path
    raise RequestError(f"{folder} holds a thousand proposals already", hint="say where with --out")


def require_experiment_place(path: Path) -> None:
    """Raise RequestError unless an experiment file may be written there, and will be found by its name."""
    if path.suffix != ".toml":
        raise RequestError(
            f"{path} does not end in .toml: labrun would not find it as an experiment",
            hint=f"--out {path}.toml",
        )
    require_free(path)


def require_free(path: Path) -> None:
    """Raise RequestError if something is there."""
    if path.exists():
        raise RequestError(f"{path} is there already", hint="name another file, or move that one away")


def experiment_text(
    bench: RunBench, trials: Sequence[PlannedTrial], remarks: Sequence[str], model: str | None
) -> str:
    """Return the experiment file of chosen trials.

    Parameters
    ----------
    remarks
        What the head of the file says.
    model
        Instead of the one that its ``[gap]`` names; None leaves that.
    """
    tree = _without_defaults(bench)
    tree["title"] = f"{tree['title']}: what tells the causes apart"
    tree["run"] = {"conditions": [dict(trial.condition) for trial in trials]}
    if model is not None:
        tree["gap"] = {**tree.get("gap", {}), "model": model}
    head = "".join(f"# {line}\n" for line in remarks)
    return f"{head}{tomli_w.dumps(tree)}"


def write_experiment(path: Path, text: str) -> None:
    """Write the file, and read it again as `labrun check` does.

    Raises
    ------
    RequestError
        It cannot be written.
    SpecError
        What was written does not hold.
    """
    _write(path, text)
    load_experiment(path)


def write_recording_plan(
    path: Path,
    name: str,
    dataset: Dataset,
    trials: Sequence[PlannedTrial],
    repeats: int,
    remarks: Sequence[str],
) -> None:
    """Write a recording whose outputs are still to be measured: its toml, and the inputs of every trial as CSV."""
    channels: dict[str, Any] = {}
    for signal in dataset.inputs:
        channels[signal.name] = {"kind": "input", "unit": signal.unit, "between": signal.between}
    for signal in dataset.outputs:
        channels[signal.name] = {"kind": "output", "unit": signal.unit}
    entries = [
        {"file": f"trial-{number}-{repeat}.csv", "condition": dict(trial.condition), "repeat": repeat}
        for number, trial in enumerate(trials, start=1)
        for repeat in range(1, repeats + 1)
    ]
    columns = ", ".join(signal.name for signal in dataset.outputs)
    head = [
        *remarks,
        f"Each CSV file holds time and inputs of one trial; what was measured goes beside them as {columns}.",
    ]
    text = "".join(f"# {line}\n" for line in head)
    text += tomli_w.dumps({"experiment": name, "channels": channels, "trials": entries})
    _write(path, text)
    header = ",".join(["time_s", *(signal.name for signal in dataset.inputs)])
    for number, trial in enumerate(trials, start=1):
        table = np.column_stack([trial.time_s, trial.inputs])
        for repeat in range(1, repeats + 1):
            file = path.parent / f"trial-{number}-{repeat}.csv"
            require_free(file)
            np.savetxt(file, table, delimiter=",", header=header, comments="", fmt="%.9g")


def _without_defaults(bench: RunBench) -> dict[str, Any]:
    """Return the experiment's tables as a person would write them: what is as it always is, left out."""
    found: dict[str, Any] = bench.experiment.model_dump(
        mode="python", by_alias=True, exclude_none=True, exclude_defaults=True
    )
    repeats = found.get("trial", {}).get("repeats")
    if isinstance(repeats, Mapping) and repeats.get("min") == repeats.get("max"):
        found["trial"]["repeats"] = repeats["min"]
    return found


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RequestError(f"{path} cannot be written: {error.strerror}") from error
