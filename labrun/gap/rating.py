"""Comparing candidates: how well each explains the data, on its own terms and on conditions it did not see."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.gap import criteria
from labrun.gap.candidates import Candidate
from labrun.gap.excess import Excess, excess
from labrun.gap.guard import Guard
from labrun.gap.held_out import held_out_residuals
from labrun.gap.noise import Noise
from labrun.gap.screening import Base, Screened


@dataclass(frozen=True)
class Rated:
    """A candidate (beside what its base has), screened and tested on withheld conditions.

    Attributes
    ----------
    evidence
        Gain over the guard's threshold.
    score
        Log likelihood it adds, tempered by how far the noise is from white, less a price for its variables.
    held_out
        Excess on conditions its fit did not see.
    share
        Part of the recalibrated model's held-out excess that it removes.
    """

    screened: Screened
    evidence: float
    score: float
    held_out: Excess
    residual: list[FloatArray]
    share: float

    @property
    def candidate(self) -> Candidate:
        """What was rated."""
        return self.screened.candidate


def rate(base: Base, screened: Screened, guard: Guard, noise: Noise, reference: Excess) -> Rated:
    """Test a screened candidate on conditions its fit did not see.

    Parameters
    ----------
    reference
        Held-out excess of the recalibrated model without any effect.
    """
    residual = held_out_residuals(screened.problem, screened.z)
    left = excess(base.problem.data, noise, residual)
    share = 1.0 - left.total / reference.total if reference.total > 0 else 0.0
    return Rated(
        screened, screened.gain / guard.threshold, score(screened, guard), left, residual, max(share, -1.0)
    )


def score(screened: Screened, guard: Guard) -> float:
    """Return the tempered log likelihood that a candidate adds, less a price for its variables."""
    return 0.5 * screened.gain / guard.dispersion - criteria.VARIABLE_PRICE * max(
        screened.candidate.variables, 1
    )


def promising(screened: Sequence[Screened], guard: Guard, most: int) -> list[Screened]:
    """Return the candidates worth a closer look, best first: those that beat noise, and the best few in any case."""
    ordered = sorted(screened, key=lambda one: -score(one, guard))
    best = score(ordered[0], guard) if ordered else 0.0
    return [
        one
        for place, one in enumerate(ordered[:most])
        if place < criteria.RATED_ANYWAY
        or (one.gain > guard.threshold and score(one, guard) > criteria.RATED_BESIDE_BEST * best)
    ]


def weights(rated: Sequence[Rated], form_slack: float) -> FloatArray:
    """Return how probable each is among these, shape (candidates,).

    Likelihoods of idealised forms are not to be believed to the last digit: a difference counts at most as far as it
    exceeds what a fraction `form_slack` of the best one's gain would make.
    """
    scores = np.array([one.score for one in rated])
    best = float(np.max(scores))
    softness = max(1.0, form_slack * best / 3.0)
    powers = np.exp((scores - best) / softness)
    return np.asarray(powers / powers.sum())
