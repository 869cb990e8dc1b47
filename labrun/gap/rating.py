"""Comparing candidates: how well each explains the data, on its own terms and on conditions it did not see."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.levenberg_marquardt import minimise
from labrun.gap import criteria
from labrun.gap.candidates import Candidate
from labrun.gap.held_out import Excess, excess, held_out_residuals
from labrun.gap.noise import Noise
from labrun.gap.noise_threshold import Guard
from labrun.gap.screening import Base, Screened


def shaped(base: Base, screened: Screened, guard: Guard) -> Screened:
    """Return the candidate with its shape fitted, if that explains clearly more; else as it was."""
    rows = sum(len(part) for part in base.residual)
    left = screened.squares - rows
    found = _with_shape(screened.candidate)
    if found is None or screened.gain < guard.threshold or left < criteria.SHAPE_REMAINDER * screened.gain:
        return screened
    candidate, choices = found
    problem = candidate.added_to(base.problem)
    size = base.problem.size
    shared, own = screened.z[:size], screened.problem.own_states(screened.z)
    ends = [
        minimise(
            problem,
            np.concatenate([shared, sizes, own]),
            tolerance=criteria.ROUGH_TOLERANCE,
            evaluations=criteria.ROUGH_EVALUATIONS,
            central=False,
        )
        for sizes in _starts(choices, screened.sizes)
    ]
    best = min(ends, key=problem.squares)
    z = minimise(
        problem, best, tolerance=criteria.FIT_TOLERANCE, evaluations=criteria.FIT_EVALUATIONS, central=False
    )
    squares = problem.squares(z)
    further = candidate.variables - screened.candidate.variables
    worth = max(criteria.SHAPE_PRICE * guard.dispersion * further, criteria.SHAPE_EARNS * screened.gain)
    if screened.squares - squares < worth:
        return screened
    return Screened(candidate, problem, z, squares, max(base.squares - squares, 0.0), screened.survey)


def _with_shape(candidate: Candidate) -> tuple[Candidate, list[tuple[float, ...]]] | None:
    """Return the candidate with its shapes among what is fitted, and the starts of every variable; None if it has none.

    The starts of what is fitted anyway are left open (empty).
    """
    attached = candidate.attached
    if attached is None or not any(parameter.shape for parameter in attached.effect.parameters):
        return None
    parameters = attached.effect.parameters
    freed = tuple(replace(one, held=False) if one.shape else one for one in parameters)
    choices = [one.starts[1:] if one.shape else () for one in parameters if one.shape or not one.held]
    effect = replace(attached.effect, parameters=freed)
    return replace(candidate, attached=replace(attached, effect=effect)), choices


def _starts(choices: list[tuple[float, ...]], sizes: FloatArray) -> list[tuple[float, ...]]:
    """Return the fitted sizes with every combination of the shapes' starts."""
    fitted = iter(sizes.tolist())
    return list(product(*(choice or (next(fitted),) for choice in choices)))


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
