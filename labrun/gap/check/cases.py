"""What a sealed answer holds and what a diagnosis said, in the words that both share."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

KINDS = ("control", "effect", "pair", "parameter", "outside")
"""What a case may be: nothing hidden, one effect, two, a parameter far off, or physics that is not in the library."""
STRENGTHS = ("below 0.5", "0.5 to 1", "1 to 3", "3 and above")
"""Classes of the true gap after recalibration, in units of one trial's noise."""
_BOUNDS = (0.5, 1.0, 3.0)
ANNOUNCING = ("explained", "partly-explained", "parameter")
"""Verdicts that blame a cause."""


@dataclass(frozen=True, slots=True)
class Cause:
    """An effect at a site, or a parameter (whose site says nothing)."""

    kind: str
    effect: str
    site: str = ""

    def alike(self, other: "Cause") -> bool:
        """Tell whether both are the same effect or parameter, wherever it sits."""
        return self.kind == other.kind and self.effect == other.effect

    def same(self, other: "Cause") -> bool:
        """Tell whether both are the same, site included."""
        return self.alike(other) and (self.kind == "parameter" or self.site == other.site)

    def __str__(self) -> str:
        return f"{self.effect} at {self.site}" if self.kind == "effect" else f"parameter {self.effect}"


@dataclass(frozen=True, slots=True)
class Named:
    """One announced cause with what it could not be told from."""

    top: Cause
    rivals: tuple[Cause, ...]
    confidence: float

    @property
    def members(self) -> tuple[Cause, ...]:
        """The set that is claimed to hold the true cause."""
        return (self.top, *(one for one in self.rivals if not one.same(self.top)))

    def __str__(self) -> str:
        return " or ".join(str(one) for one in self.members)


@dataclass(frozen=True, slots=True)
class Shrunk:
    """A predicted share of the excess that the causes remove, with its 90 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Truth:
    """A sealed answer.

    Attributes
    ----------
    kind
        One of `KINDS`.
    gap
        True systematic residual after recalibration, in units of one trial's noise.
    forms
        What was simulated, in words.
    """

    case: str
    kind: str
    causes: tuple[Cause, ...]
    gap: float
    bench: str
    repeats: int
    seed: int
    forms: tuple[str, ...]

    @property
    def strength(self) -> str:
        """Class of the gap, one of `STRENGTHS`."""
        return STRENGTHS[sum(self.gap >= bound for bound in _BOUNDS)]

    @classmethod
    def from_json(cls, answer: Mapping[str, Any]) -> "Truth":
        """Read an answer as the generator writes it."""
        causes = tuple(
            Cause(one.get("kind", "effect"), one["effect"], one.get("site") or "") for one in answer["causes"]
        )
        hidden = answer.get("hidden", ())
        return cls(
            answer["case"],
            answer["kind"],
            causes,
            float(answer["gap"]["recalibrated"]),
            answer.get("bench", ""),
            int(answer.get("repeats", 0)),
            int(answer["seed"]),
            tuple(f"{one.get('form', one.get('effect', '?'))} at {one.get('site', '?')}" for one in hidden),
        )


@dataclass(frozen=True, slots=True)
class Said:
    """What the diagnosis said of a case; `error` where it said nothing at all."""

    case: str
    verdict: str
    named: tuple[Named, ...]
    shrinkage: Shrunk | None
    seconds: float
    error: str = ""

    @property
    def announced(self) -> tuple[Named, ...]:
        """The causes it blames; none where the verdict blames none."""
        return self.named if self.verdict in ANNOUNCING else ()

    @classmethod
    def from_json(cls, case: str, said: Mapping[str, Any]) -> "Said":
        """Read what ``labrun gap diagnose --json`` prints, or ``{"error": ...}``."""
        if "error" in said:
            return cls(case, "error", (), None, float(said.get("seconds", 0.0)), str(said["error"]))
        share = (said.get("shrinkage") or {}).get("share_removed")
        if share is not None and None in (share["value"], *share["ci90"]):
            share = None
        unsure = [one["confidence"] for one in said["causes"] if not _is_probability(one["confidence"])]
        if unsure:
            return cls(case, "error", (), None, float(said["seconds"]), f"states a confidence of {unsure[0]}")
        return cls(
            case,
            said["verdict"],
            tuple(_named(one) for one in said["causes"]),
            None if share is None else Shrunk(share["value"], *share["ci90"]),
            float(said["seconds"]),
        )


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
        """Read what `labrun.gap.check.shrinking` returns."""
        return cls(shown.get("share"), bool(shown.get("counted", False)), str(shown.get("error", "")))


def _is_probability(value: Any) -> bool:
    return isinstance(value, float | int) and 0.0 <= value <= 1.0


def _named(one: Mapping[str, Any]) -> Named:
    rivals = tuple(
        Cause(rival.get("kind", "effect"), rival["effect"], rival.get("site") or "")
        for rival in one["indistinguishable_from"]
    )
    top = Cause(one["kind"], one["effect"], one.get("site") or "")
    return Named(top, rivals, float(one["confidence"]))
