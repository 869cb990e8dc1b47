"""One sealed case: its answer, what the diagnosis said, what fresh trials showed, and what became of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

KINDS = ("control", "effect", "pair", "parameter", "outside")
"""What a case may be: nothing hidden, one effect, two, a parameter far off, or physics that is not in the library."""
STRENGTHS = ("below 0.5", "0.5 to 1", "1 to 3", "3 and above")
"""Classes of the true gap after recalibration, in units of one trial's noise."""
_BOUNDS = (0.5, 1.0, 3.0)
ANNOUNCING = ("explained", "partly-explained", "parameter")
"""Verdicts that blame a cause."""
Outcome = Literal[
    "named", "wrong-site", "set-too-large", "not-first", "wrong-cause", "said-unknown", "nothing-said",
    "both-named", "one-named", "none-named", "quiet", "false-alarm", "recognised", "blamed", "error",
]  # fmt: skip
"""What became of a case. Of one hidden cause: named (alone or in a set of two), named at the wrong site, in a set of
three or more, only behind another cause, not among the causes, called unknown, or nothing was said. Of two: how many
were named. Of none: quiet, an effect was blamed, or something unknown was. Outside of the library: recognised, a cause
was blamed, or nothing was said."""
LARGEST_SET = 2
MANY_TRIALS = 50
"""No more are drawn: ten conditions, five times each."""
GOOD: tuple[Outcome, ...] = ("named", "both-named", "quiet", "recognised")


@dataclass(frozen=True, slots=True)
class CauseName:
    """An effect at a site, or a parameter (whose site says nothing)."""

    kind: str
    effect: str
    site: str = ""

    @classmethod
    def from_json(cls, named: Mapping[str, Any]) -> "CauseName":
        """Read one as an answer or a diagnosis writes it."""
        return cls(named.get("kind", "effect"), named["effect"], named.get("site") or "")

    def alike(self, other: "CauseName") -> bool:
        """Tell whether both are the same effect or parameter, wherever it sits."""
        return self.kind == other.kind and self.effect == other.effect

    def same(self, other: "CauseName") -> bool:
        """Tell whether both are the same, site included."""
        return self.alike(other) and (self.kind == "parameter" or self.site == other.site)

    def __str__(self) -> str:
        return f"{self.effect} at {self.site}" if self.kind == "effect" else f"parameter {self.effect}"


Sizes = Mapping[str, float]
Intervals = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Named:
    """One announced cause with what it could not be told from.

    Attributes
    ----------
    intervals : parameter -> ends
        Of 95 %, of the sizes of `top`.
    """

    top: CauseName
    rivals: tuple[CauseName, ...]
    confidence: float
    intervals: Intervals = field(default_factory=dict)

    @property
    def members(self) -> tuple[CauseName, ...]:
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
    noise, zeros
        Colour of the noise, and whether each trial has a zero of its own.
    conditions
        How many were recorded, each `repeats` times.
    sizes : per cause, parameter -> value
        Of the form that was simulated.
    """

    case: str
    kind: str
    causes: tuple[CauseName, ...]
    gap: float
    bench: str
    repeats: int
    seed: int
    forms: tuple[str, ...]
    noise: str = ""
    zeros: bool = False
    sizes: tuple[Sizes, ...] = ()
    conditions: int = 0

    @property
    def data(self) -> tuple[str, ...]:
        """What its recording is like, in words."""
        repeats = f"{self.repeats} repeat" + ("s" if self.repeats != 1 else "")
        return (
            repeats,
            *((f"{self.noise} noise",) if self.noise else ()),
            *(("zeros by trial",) if self.zeros else ()),
            *(("many trials",) if self.conditions * self.repeats > MANY_TRIALS else ()),
        )

    @property
    def strength(self) -> str:
        """Class of the gap, one of `STRENGTHS`."""
        return STRENGTHS[sum(self.gap >= bound for bound in _BOUNDS)]

    @classmethod
    def from_json(cls, answer: Mapping[str, Any]) -> "Truth":
        """Read an answer as the generator writes it."""
        causes = tuple(CauseName.from_json(one) for one in answer["causes"])
        hidden = answer.get("hidden", ())
        true = answer.get("true_parameters", {})
        released = [{one.effect: true[one.effect]} for one in causes if one.effect in true]
        return cls(
            answer["case"],
            answer["kind"],
            causes,
            float(answer["gap"]["recalibrated"]),
            answer.get("bench", ""),
            int(answer.get("repeats", 0)),
            int(answer["seed"]),
            tuple(f"{one.get('form', one.get('effect', '?'))} at {one.get('site', '?')}" for one in hidden),
            str(answer.get("noise", {}).get("colour", "")),
            bool(answer.get("noise", {}).get("zero_by_trial", 0.0)),
            tuple(one.get("values", {}) for one in hidden) or tuple(released),
            int(answer.get("conditions", 0)),
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
            tuple(_named(one, said.get("candidates", ())) for one in said["causes"]),
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
        """Read what `labrun.blind.jobs.shrink_case` returns."""
        return cls(shown.get("share"), bool(shown.get("counted", False)), str(shown.get("error", "")))


@dataclass(frozen=True, slots=True)
class Judged:
    """A case with its answer, what was said, and what became of it.

    Attributes
    ----------
    found
        How many of the true causes were named, alone or in a set of two.
    sites
        How many of those at their true site.
    extra
        Announced causes of kind effect beyond as many as there are.
    """

    truth: Truth
    said: Said
    shown: Shown | None
    outcome: Outcome
    found: int
    sites: int
    extra: int

    @property
    def good(self) -> bool:
        """Tell whether it came out as one would wish, with no effect announced beyond those that are there."""
        return self.outcome in GOOD and not self.extra


def judge(truth: Truth, said: Said, shown: Shown | None = None) -> Judged:
    """Say what became of a case."""
    effects = sum(one.top.kind == "effect" for one in said.announced)
    extra = max(0, effects - sum(one.kind == "effect" for one in truth.causes))
    if said.error:
        return Judged(truth, said, shown, "error", 0, 0, 0)
    if truth.kind == "pair":
        found, sites = _matched(truth.causes, said.announced)
        outcomes: tuple[Outcome, ...] = ("none-named", "one-named", "both-named")
        return Judged(truth, said, shown, outcomes[found], found, sites, extra)
    if truth.kind in ("effect", "parameter"):
        outcome = _single(truth.causes[0], said)
        named = outcome in ("named", "wrong-site")
        return Judged(truth, said, shown, outcome, int(named), int(outcome == "named"), extra)
    if truth.kind == "outside":
        return Judged(truth, said, shown, _outside(said), 0, 0, 0)
    return Judged(truth, said, shown, _control(said, effects), 0, 0, extra)


def right(cause: CauseName, truth: Truth) -> bool:
    """Tell whether an announced cause is a true one, site included."""
    return any(cause.same(one) for one in truth.causes)


def held(named: Named, truth: Truth) -> bool:
    """Tell whether an announced cause, or the first of its rivals, is a true one: what its confidence is about."""
    return any(right(one, truth) for one in named.members[:2])


OTHER_SIZES = (
    "hysteresis", "viscoelastic-creep", "cubic-stiffness", "drift", "reynolds-dependent-drag", "mean-current",
    "wall-echo", "stribeck-friction",
)  # fmt: skip
"""Effects whose simulated form has no size of the same meaning as the library's: five elements for one, a third and a
fifth order for a third, a drift that tires for one that does not."""


def sizes_held(judged: Judged) -> list[bool]:
    """Tell of each announced cause that is a true one whether its interval holds the size that was simulated.

    It is the first parameter of the same name; `OTHER_SIZES` are left out.
    """
    truth, found = judged.truth, list[bool]()
    for named in judged.said.announced:
        for cause, sizes in zip(truth.causes, truth.sizes, strict=False):
            name = next((one for one in named.intervals if one in sizes), None)
            if named.top.same(cause) and name is not None and cause.effect not in OTHER_SIZES:
                low, high = named.intervals[name]
                found.append(low <= sizes[name] <= high)
    return found


def _single(true: CauseName, said: Said) -> Outcome:
    if not said.announced:
        return "said-unknown" if said.verdict == "not-in-library" else "nothing-said"
    top = said.announced[0]
    if _holds(top, true, CauseName.alike):
        if len(top.members) > LARGEST_SET:
            return "set-too-large"
        return "named" if _holds(top, true, CauseName.same) else "wrong-site"
    behind = any(_holds(one, true, CauseName.alike) for one in said.announced[1:])
    return "not-first" if behind else "wrong-cause"


def _control(said: Said, effects: int) -> Outcome:
    if effects:
        return "false-alarm"
    return "said-unknown" if said.verdict == "not-in-library" else "quiet"


def _outside(said: Said) -> Outcome:
    if said.verdict == "not-in-library":
        return "recognised"
    return "blamed" if said.announced else "nothing-said"


def _holds(named: Named, true: CauseName, equal: Callable[[CauseName, CauseName], bool]) -> bool:
    return any(equal(one, true) for one in named.members)


def _matched(causes: Sequence[CauseName], announced: Sequence[Named]) -> tuple[int, int]:
    """Return how many of two causes were named, each by a set of its own, and how many of those at their site."""
    small = [one for one in announced if len(one.members) <= LARGEST_SET]
    best = (0, 0)
    for first in (*small, None):
        for second in (*small, None):
            if first is not None and first is second:
                continue
            pairs = [
                (one, cause) for one, cause in zip((first, second), causes, strict=True) if one is not None
            ]
            found = sum(_holds(one, cause, CauseName.alike) for one, cause in pairs)
            best = max(best, (found, sum(_holds(one, cause, CauseName.same) for one, cause in pairs)))
    return best


def _is_probability(value: Any) -> bool:
    return isinstance(value, float | int) and 0.0 <= value <= 1.0


def whole_set(one: Mapping[str, Any], candidates: Sequence[Mapping[str, Any]]) -> tuple[CauseName, ...]:
    """Return an announced cause, the rival that is told beside it, and all further ones of the table of candidates.

    Parameters
    ----------
    one, candidates
        Of what ``labrun gap diagnose --json`` prints.
    """
    cause = CauseName.from_json(one)
    told = [cause, *(CauseName.from_json(rival) for rival in one["indistinguishable_from"])]
    further = [
        CauseName.from_json(other)
        for other in candidates
        if other["verdict"] == "indistinguishable"
        and any(CauseName.from_json(of).same(cause) for of in other["indistinguishable_from"])
    ]
    return (*told, *(other for other in further if not any(other.same(rival) for rival in told)))


def _named(one: Mapping[str, Any], candidates: Sequence[Mapping[str, Any]]) -> Named:
    cause, *rivals = whole_set(one, candidates)
    intervals = {name: tuple(value["ci95"]) for name, value in one.get("values", {}).items()}
    return Named(cause, tuple(rivals), float(one["confidence"]), intervals)
