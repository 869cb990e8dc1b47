"""What `labrun gap next` answers: which trials, how long they take, what they would tell apart."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from labrun.gap.diagnosis import Name
from labrun.gap.next.trials import PlannedTrial

Outcome = Literal["separates", "helps", "cannot"]

SURE = 1.5
_CLEARLY = 2.0


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
        return self.ratio >= SURE and self.sigma < _CLEARLY


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
        if known is None or (one.ratio >= SURE, one.sigma) < (known.ratio >= SURE, known.sigma):
            worst[pair] = one
    return [_told(one) for one in worst.values()]


def _told(one: Outlook) -> str:
    if one.by_simplicity:
        return f"if it is {one.truth}, {one.rival} can do the same with more parameters: the simpler is named"
    if one.ratio >= SURE:
        return f"{one.truth} or {one.rival}: told apart, at {_number(one.sigma)} standard deviations"
    if one.sigma < _CLEARLY:
        return f"{one.truth} or {one.rival}: not told apart, they predict the same"
    return f"{one.truth} or {one.rival}: {_number(one.sigma)} standard deviations, too few for what the effect shows"


def _number(sigma: float) -> str:
    return f"{sigma:.0f}" if sigma >= 10 else f"{sigma:.1f}"
