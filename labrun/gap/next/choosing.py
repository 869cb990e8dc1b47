"""Which few trials of a pool: greedily, those that bring most evidence per minute of rig time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labrun.gap.next.proposal import SURE

if TYPE_CHECKING:
    from labrun.gap.next.separation import Evidence, Separation

FEWEST, MOST = 2, 4
"""How many trials are proposed."""
ENOUGH = 3.0
"""Evidence, over what a diagnosis asks for, at which no further trial is needed."""
_HOPELESS = 0.1
"""Evidence of the whole pool below which a pair has no part in the choice."""


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


def choose(separation: "Separation", enough: float = ENOUGH) -> Choice:
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
    if aim.least(cheap.evidence) >= SURE:
        return cheap
    best = _greedy(separation, aim, dear=0.0)
    return best if aim.value(best.evidence) > aim.value(cheap.evidence) else cheap


@dataclass(frozen=True)
class _Aim:
    """What counts: the pairs that any trials of the pool can separate, each up to `enough`."""

    pairs: tuple[int, ...]
    enough: float

    @classmethod
    def of(cls, separation: "Separation", enough: float) -> "_Aim":
        alone = [separation.evidence([k]) for k in range(len(separation.trials))]
        alone.append(separation.evidence(range(len(separation.trials))))
        most = [max(looks[pair].ratio for looks in alone) for pair in range(len(alone[0]))]
        hopeful = tuple(pair for pair, ratio in enumerate(most) if ratio >= _HOPELESS)
        return cls(hopeful or tuple(range(len(most))), enough)

    def value(self, evidence: "Sequence[Evidence]") -> float:
        """Return the evidence of all pairs; what one has beyond enough does not make up for another."""
        ratios = [min(max(evidence[pair].ratio, -1.0), self.enough) for pair in self.pairs]
        return sum(ratios) + len(ratios) * min(ratios)

    def least(self, evidence: "Sequence[Evidence]") -> float:
        """Return the evidence of the pair that is told apart worst."""
        return min(evidence[pair].ratio for pair in self.pairs)


def _greedy(separation: "Separation", aim: _Aim, dear: float) -> Choice:
    """Add the trial that raises the evidence most for its time (to the power `dear`), until there is enough."""
    chosen: list[int] = []
    value = aim.value(separation.evidence(chosen))
    doubt = [separation.doubt(k) for k in range(len(separation.trials))]
    while len(chosen) < min(MOST, len(separation.trials)):
        rest = [k for k in range(len(separation.trials)) if k not in chosen]
        gains = [aim.value(separation.evidence([*chosen, k])) - value for k in rest]
        worth = [
            gain / (doubt[k] * separation.trials[k].cost_s ** dear)
            for gain, k in zip(gains, rest, strict=True)
        ]
        at = int(np.argmax(worth))
        if len(chosen) >= FEWEST and gains[at] <= 0.02 * max(value, 1e-12):
            break
        chosen.append(rest[at])
        value += gains[at]
        if len(chosen) >= FEWEST and aim.least(separation.evidence(chosen)) >= aim.enough:
            break
    return Choice(tuple(chosen), tuple(separation.evidence(chosen)))
