"""Judge one sealed case: the hidden truth, the answer, and the outcome."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import ValidationError

from labrun.blind.answer import Answer, Cause, CauseName, reason_of
from labrun.blind.truth import Truth

Outcome = Literal[
    "named", "wrong-site", "set-too-large", "wrong-cause", "gap-without-cause", "nothing-said",
    "both-named", "one-named", "none-named", "quiet", "gap-reported", "false-alarm",
    "rest-told", "not-blamed", "blamed", "no-answer",
]  # fmt: skip
"""What became of a case. Of one hidden cause: named at its site (alone or in a set of two), named at another site, in a
set of three or more, not among the causes, a gap was reported without a cause, or nothing was said. Of two: how many
were named. Of none: quiet, a gap was reported, or a cause was claimed. Outside of the library: the rest was told as
unexplained, no cause was claimed that closes less than half of the gap, or one was."""
LARGEST_SET = 2
RIGHT: tuple[Outcome, ...] = ("named", "both-named", "quiet", "rest-told", "not-blamed")


@dataclass(frozen=True, slots=True)
class PredictedShare:
    """The share of the excess that the causes are predicted to remove, with its 90 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def of_diagnosis(cls, printed: Mapping[str, Any]) -> "PredictedShare | None":
        """Read it from what ``labrun gap diagnose --json`` prints; None where it predicts nothing."""
        share = (printed.get("shrinkage") or {}).get("share_removed")
        if share is None or None in (share["value"], *share["ci90"]):
            return None
        return cls(share["value"], *share["ci90"])


@dataclass(frozen=True, slots=True)
class Reply:
    """What a program replied to a case: an answer, or the reason why there is none."""

    answer: Answer | None
    reason: str = ""
    processor_s: float = 0.0
    predicted: PredictedShare | None = None

    @classmethod
    def of_labrun(cls, kept: Mapping[str, Any]) -> "Reply":
        """Read what ``labrun gap diagnose --json`` prints, or ``{"error": ...}``."""
        return cls._read(kept, Answer.of_diagnosis, PredictedShare.of_diagnosis)

    @classmethod
    def of_tool(cls, kept: Mapping[str, Any]) -> "Reply":
        """Read what another program printed, or ``{"error": ...}``."""
        return cls._read(kept, Answer.model_validate, lambda _: None)

    @classmethod
    def _read(
        cls,
        kept: Mapping[str, Any],
        answer_of: Callable[[Mapping[str, Any]], Answer],
        predicted_of: Callable[[Mapping[str, Any]], PredictedShare | None],
    ) -> "Reply":
        seconds = float(kept.get("processor_s", 0.0))
        if "error" in kept:
            return cls(None, str(kept["error"]), seconds)
        try:
            return cls(answer_of(kept), "", seconds, predicted_of(kept))
        except ValidationError as error:
            return cls(None, reason_of(error), seconds)


@dataclass(frozen=True, slots=True)
class Shown:
    """What the fresh trials of a case showed of the corrected model.

    Attributes
    ----------
    value
        Share of the recalibrated excess that the causes remove there; None where it could not be computed.
    counted
        Whether the fresh excess stands far enough above the noise for a share of it to mean anything.
    """

    value: float | None
    counted: bool
    error: str = ""

    @classmethod
    def from_json(cls, shown: Mapping[str, Any]) -> "Shown":
        """Read what `labrun.blind.jobs.shrink_case` returns."""
        return cls(shown.get("share"), bool(shown.get("counted", False)), str(shown.get("error", "")))


@dataclass(frozen=True, slots=True)
class Judged:
    """A case with its sealed answer, the reply, and the outcome.

    Attributes
    ----------
    named
        How many of the hidden causes were named at their site, alone or in a set of two.
    effects
        How many were named at any site.
    false_causes
        Claimed causes whose set holds nothing that is hidden; outside of the library, those that close less than half.
    """

    truth: Truth
    reply: Reply
    shown: Shown | None
    outcome: Outcome
    named: int
    effects: int
    false_causes: int

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The causes that are claimed."""
        return () if self.reply.answer is None else self.reply.answer.causes

    @property
    def right(self) -> bool:
        """Tell whether it came out as wished, without a false cause."""
        return self.outcome in RIGHT and not self.false_causes


def judge(truth: Truth, reply: Reply, shown: Shown | None = None) -> Judged:
    """Judge the answer to a case."""
    answer = reply.answer
    if answer is None:
        return Judged(truth, reply, shown, "no-answer", 0, 0, 0)
    small = [cause for cause in answer.causes if len(cause.members) <= LARGEST_SET]
    named = _matched(truth.causes, small, CauseName.__eq__)
    effects = _matched(truth.causes, small, CauseName.has_effect_of)
    if truth.kind == "outside":
        false = sum(not cause.closes_half for cause in answer.causes)
        outcome: Outcome = "rest-told" if answer.tells_rest else "blamed" if false else "not-blamed"
        return Judged(truth, reply, shown, outcome, 0, 0, 0 if answer.tells_rest else false)
    false = len(answer.causes) - _matched(truth.causes, answer.causes, CauseName.__eq__)
    if truth.kind == "control":
        outcome = "false-alarm" if answer.causes else "gap-reported" if answer.gap else "quiet"
    elif truth.kind == "pair":
        of_pair: tuple[Outcome, ...] = ("none-named", "one-named", "both-named")
        outcome = of_pair[named]
    else:
        outcome = _of_single(truth.causes[0], answer, bool(named), bool(effects))
    return Judged(truth, reply, shown, outcome, named, effects, false)


def is_held(cause: Cause, truth: Truth) -> bool:
    """Tell whether a cause, or the first of its rivals, is a true one: what its confidence is about."""
    return any(member in truth.causes for member in cause.members[:LARGEST_SET])


OTHER_SIZES = (
    "hysteresis", "viscoelastic-creep", "cubic-stiffness", "drift", "reynolds-dependent-drag", "mean-current",
    "wall-echo", "stribeck-friction",
)  # fmt: skip
"""Effects whose simulated form has no size of the same meaning as the library's: five elements for one, a third and a
fifth order for a third, a drift that tires for one that does not."""


def sizes_held(judged: Judged) -> list[bool]:
    """Tell of each claimed cause that is a true one whether its interval holds the size that was simulated.

    It is the first parameter of the same name; `OTHER_SIZES` are left out, and sizes without an interval.
    """
    held = []
    for cause in judged.causes:
        for hidden, sizes in zip(judged.truth.causes, judged.truth.sizes, strict=False):
            if cause.name != hidden or hidden.effect in OTHER_SIZES:
                continue
            intervals = {name: size.ci95 for name, size in cause.size.items() if name in sizes}
            name, interval = next(iter(intervals.items()), ("", None))
            if interval is not None:
                held.append(interval[0] <= sizes[name] <= interval[1])
    return held


def _of_single(hidden: CauseName, answer: Answer, is_named: bool, is_named_elsewhere: bool) -> Outcome:
    if is_named:
        return "named"
    if is_named_elsewhere:
        return "wrong-site"
    if any(hidden in cause.members for cause in answer.causes):
        return "set-too-large"
    if answer.causes:
        return "wrong-cause"
    return "gap-without-cause" if answer.gap else "nothing-said"


def _matched(
    hidden: Sequence[CauseName],
    causes: Sequence[Cause],
    equal: Callable[[CauseName, CauseName], bool],
) -> int:
    """Return how many hidden causes are held by a claimed cause of their own (a maximum matching)."""
    if not hidden:
        return 0
    first, *others = hidden
    best = _matched(others, causes, equal)
    for index, cause in enumerate(causes):
        if any(equal(member, first) for member in cause.members):
            rest = [*causes[:index], *causes[index + 1 :]]
            best = max(best, 1 + _matched(others, rest, equal))
    return best
