"""Which few trials of a pool: greedily, those that bring most evidence per minute of rig time."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from labrun.gap.next.separation import Evidence, Separation

FEWEST, MOST = 2, 4
"""How many trials are proposed."""
ENOUGH = 2.0
"""Evidence, over what a diagnosis asks for, at which no further trial is needed."""


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
    evidence: "tuple[Evidence, ...]"

    @property
    def least(self) -> float:
        """Evidence of the pair that is told apart worst."""
        return min((one.ratio for one in self.evidence), default=0.0)


def choose(separation: "Separation") -> Choice:
    """Return a few trials; the cheapest way first, and whatever separates best if that does not decide."""
    if not separation.trials:
        return Choice((), tuple(separation.evidence(())))
    cheap = _greedy(separation, dear=1.0)
    if cheap.least >= 1.0:
        return cheap
    best = _greedy(separation, dear=0.0)
    return best if best.least > cheap.least else cheap


def _greedy(separation: "Separation", dear: float) -> Choice:
    """Add the trial that raises the evidence most for its time (to the power `dear`), until there is enough."""
    chosen: list[int] = []
    value = _value(separation, chosen)
    while len(chosen) < min(MOST, len(separation.trials)):
        rest = [k for k in range(len(separation.trials)) if k not in chosen]
        gains = [_value(separation, [*chosen, k]) - value for k in rest]
        worth = [gain / separation.trials[k].cost_s ** dear for gain, k in zip(gains, rest, strict=True)]
        at = int(np.argmax(worth))
        if len(chosen) >= FEWEST and gains[at] <= 0.02 * max(value, 1e-12):
            break
        chosen.append(rest[at])
        value += gains[at]
        if len(chosen) >= FEWEST and _least(separation, chosen) >= ENOUGH:
            break
    return Choice(tuple(chosen), tuple(separation.evidence(chosen)))


def _value(separation: "Separation", chosen: list[int]) -> float:
    """Return the evidence of all pairs; what one has beyond enough does not make up for another."""
    ratios = [one.ratio for one in separation.evidence(chosen)]
    return sum(min(max(ratio, -1.0), ENOUGH) for ratio in ratios) + ENOUGH * min(min(ratios), ENOUGH)


def _least(separation: "Separation", chosen: list[int]) -> float:
    return min(one.ratio for one in separation.evidence(chosen))
