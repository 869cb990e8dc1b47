"""Hold one diagnosis against its answer."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from labrun.gap.check.cases import Cause, Named, Said, Shown, Truth

Outcome = Literal[
    "named", "wrong-site", "set-too-large", "not-first", "wrong-cause", "said-unknown", "nothing-said",
    "both-named", "one-named", "none-named", "quiet", "false-alarm", "recognised", "blamed", "error",
]  # fmt: skip
"""What became of a case. Of one hidden cause: named (alone or in a set of two), named at the wrong site, in a set of
three or more, only behind another cause, not among the causes, called unknown, or nothing was said. Of two: how many
were named. Of none: quiet, an effect was blamed, or something unknown was. Outside of the library: recognised, a cause
was blamed, or nothing was said."""
LARGEST_SET = 2
GOOD: tuple[Outcome, ...] = ("named", "both-named", "quiet", "recognised")


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
        """Whether it came out as one would wish, with no effect announced beyond those that are there."""
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


def right(cause: Cause, truth: Truth) -> bool:
    """Tell whether an announced cause is a true one, site included."""
    return any(cause.same(one) for one in truth.causes)


def held(named: Named, truth: Truth) -> bool:
    """Tell whether an announced cause, or the first of its rivals, is a true one: what its confidence is about."""
    return any(right(one, truth) for one in named.members[:2])


def _single(true: Cause, said: Said) -> Outcome:
    if not said.announced:
        return "said-unknown" if said.verdict == "not-in-library" else "nothing-said"
    top = said.announced[0]
    if _holds(top, true, Cause.alike):
        if len(top.members) > LARGEST_SET:
            return "set-too-large"
        return "named" if _holds(top, true, Cause.same) else "wrong-site"
    behind = any(_holds(one, true, Cause.alike) for one in said.announced[1:])
    return "not-first" if behind else "wrong-cause"


def _control(said: Said, effects: int) -> Outcome:
    if effects:
        return "false-alarm"
    return "said-unknown" if said.verdict == "not-in-library" else "quiet"


def _outside(said: Said) -> Outcome:
    if said.verdict == "not-in-library":
        return "recognised"
    return "blamed" if said.announced else "nothing-said"


def _holds(named: Named, true: Cause, equal: Callable[[Cause, Cause], bool]) -> bool:
    return any(equal(one, true) for one in named.members)


def _matched(causes: Sequence[Cause], announced: Sequence[Named]) -> tuple[int, int]:
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
            found = sum(_holds(one, cause, Cause.alike) for one, cause in pairs)
            best = max(best, (found, sum(_holds(one, cause, Cause.same) for one, cause in pairs)))
    return best
