"""Comparing candidates: how well each explains the data, on its own terms and on conditions it did not see."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import minimise
from labrun.gap import criteria
from labrun.gap.candidates import Candidate
from labrun.gap.held_out import Excess, held_out_excess
from labrun.gap.noise import Noise
from labrun.gap.noise_threshold import NoiseThreshold
from labrun.gap.screening import Base, Screened


@dataclass(frozen=True)
class Rated:
    """A candidate (beside what its base has), screened and tested on withheld conditions.

    Attributes
    ----------
    evidence
        Gain over what noise alone would let the best candidate gain.
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
    share: float

    @property
    def candidate(self) -> Candidate:
        """What was rated."""
        return self.screened.candidate


def rate(screened: Screened, threshold: NoiseThreshold, noise: Noise, reference: Excess) -> Rated:
    """Test a screened candidate on conditions its fit did not see.

    Parameters
    ----------
    reference
        Held-out excess of the recalibrated model without any effect.
    """
    left = held_out_excess(screened.problem, screened.z, noise)
    share = 1.0 - left.total / reference.total if reference.total > 0 else 0.0
    evidence = screened.gain / threshold.gain
    return Rated(screened, evidence, score(screened, threshold), left, max(share, -1.0))


def score(screened: Screened, threshold: NoiseThreshold) -> float:
    """Return the tempered log likelihood that a candidate adds, less a price for its variables."""
    price = criteria.VARIABLE_PRICE * max(screened.candidate.variables, 1)
    return 0.5 * screened.gain / threshold.dispersion - price


def promising(screened: Sequence[Screened], threshold: NoiseThreshold, most: int) -> list[Screened]:
    """Return the candidates worth a closer look, best first: those that beat noise, and the best few in any case."""
    ordered = sorted(screened, key=lambda one: -score(one, threshold))
    best = score(ordered[0], threshold) if ordered else 0.0
    return [
        one
        for place, one in enumerate(ordered[:most])
        if place < criteria.RATED_ANYWAY
        or (one.gain > threshold.gain and score(one, threshold) > criteria.RATED_BESIDE_BEST * best)
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


def preferred(rated: Sequence[Rated], left: Excess, reference: Excess, *, further: bool) -> Rated | None:
    """Return the candidate to take in; the simplest of those that do as well as the best. None if none is needed.

    Parameters
    ----------
    left
        Held-out excess without it.
    """
    passing = [one for one in rated if one.evidence > 1.0]
    if further and reference.total > 0:
        passing = [one for one in passing if _earns_its_place(one, left, reference)]
    if not passing:
        return None
    most = max(one.share for one in passing)
    # what fits the seen conditions well and fails on the unseen has learned the wrong thing
    # ... but where all fail there alone, as each of two causes may, how badly they do says little
    least = most - criteria.SHARE_BEHIND_BEST if most >= criteria.LEAST_SHARE else -np.inf
    fair = [one for one in passing if one.share >= least]
    best = max(fair, key=lambda one: one.score)
    probable = weights(fair, _slack(best))
    alike = [
        one
        for one, weight in zip(fair, probable, strict=True)
        if one.candidate.variables < best.candidate.variables
        and one.share >= best.share - criteria.SIMPLER_SHARE
        and weight >= criteria.RIVAL_WEIGHT
    ]
    return max(alike, key=lambda one: one.score) if alike else best


def _earns_its_place(one: Rated, left: Excess, reference: Excess) -> bool:
    """Tell whether a further cause removes enough on withheld conditions, of the whole gap or of what is left of it."""
    removed = left.total - one.held_out.total
    share = removed / reference.total
    if share >= criteria.ANOTHER_SHARE:
        return True
    if share >= criteria.NOTICED_SHARE and removed >= criteria.NOTICED_OF_LEFT * left.total:
        return True
    nearly_all = removed >= criteria.SMALL_OF_LEFT * left.total and left.gap >= criteria.SMALL_GAP
    return share >= criteria.SMALL_SHARE and nearly_all


def rivals_of(best: Rated, rated: Sequence[Rated]) -> tuple[tuple[tuple[Rated, float], ...], float]:
    """Return what cannot be told from the best, most probable first, and the best one's own weight."""
    near = [
        one
        for one in rated
        if one.evidence > criteria.RIVAL_EVIDENCE
        and one.share >= best.share - criteria.RIVAL_SHARE
        and not _best_again(best, one)
    ]
    if best not in near:
        near.append(best)
    shares = weights(near, _slack(best))
    own = float(shares[near.index(best)])
    ordered = sorted(zip(near, shares, strict=True), key=lambda pair: -pair[1])
    return tuple(
        (one, float(weight)) for one, weight in ordered if one is not best and weight >= criteria.RIVAL_WEIGHT
    ), own


def _best_again(best: Rated, one: Rated) -> bool:
    """Tell whether this is the best again, a richer form at its site that earns nothing by what it has more."""
    simple, rich = best.candidate, one.candidate
    if simple.attached is None or rich.attached is None or simple.name.site != rich.name.site:
        return False
    return simple.name.effect in rich.attached.effect.contains and one.score <= best.score


def _slack(best: Rated) -> float:
    """Return how far forms are to be believed: where the best one's leaves nothing, what leaves something is not it."""
    screened = best.screened
    rows = sum(part.size for part in best.held_out.residual)
    left = max(screened.squares - rows, 0.0) / screened.gain if screened.gain > 0 else 1.0
    return float(np.clip(left, *criteria.IDEALISED_FORM))


def shaped(base: Base, screened: Screened, threshold: NoiseThreshold) -> Screened:
    """Return the candidate with its shape fitted, if that explains clearly more; else as it was."""
    rows = sum(len(part) for part in base.residual)
    left = screened.squares - rows
    found = _with_shape(screened.candidate)
    if found is None or screened.gain < threshold.gain or left < criteria.SHAPE_REMAINDER * screened.gain:
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
    worth = max(criteria.SHAPE_PRICE * threshold.dispersion * further, criteria.SHAPE_EARNS * screened.gain)
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
