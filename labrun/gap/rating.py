"""Comparing candidates: how well each explains the data, on its own terms and on conditions it did not see."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Problem
from labrun.gap import criteria
from labrun.gap.candidates import Candidate, family, rank
from labrun.gap.held_out import ExcessResidual, held_out_excess
from labrun.gap.noise import Noise
from labrun.gap.noise_threshold import NoiseThreshold
from labrun.gap.recalibration import settled_in_own_units
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
    left
        Part of its gain that is left beyond noise.
    conditions
        How many conditions it gains in, each weighed by the share that it removes there: 1 if it does in one alone.
    """

    screened: Screened
    evidence: float
    score: float
    held_out: ExcessResidual
    share: float
    left: float
    conditions: float

    @property
    def candidate(self) -> Candidate:
        """What was rated."""
        return self.screened.candidate


def rate(
    base: Base, screened: Screened, threshold: NoiseThreshold, noise: Noise, reference: ExcessResidual
) -> Rated:
    """Test a screened candidate on conditions its fit did not see.

    Parameters
    ----------
    reference
        Held-out excess of the recalibrated model without any effect.
    """
    own = screened.problem
    if not noise.known:
        screened, own = _in_own_units(base, screened, noise)
    left = held_out_excess(own, screened.z, noise)
    share = 1.0 - left.total / reference.total if reference.total > 0 else 0.0
    beyond = max(screened.squares - threshold.floor, 0.0)
    return Rated(
        screened,
        threshold.evidence(threshold.less_luck(screened.gain, screened.survey.among)),
        score(screened, threshold),
        left,
        max(share, -1.0),
        beyond / screened.gain if screened.gain > 0 else 1.0,
        _conditions(base, screened),
    )


def _in_own_units(base: Base, screened: Screened, noise: Noise) -> tuple[Screened, Problem]:
    """Return a candidate fitted in units of what it leaves, and the problem in these.

    In those of what its base leaves, what is stated of parameters holds them as if no better model were known: a cause
    that leaves little would look no better than one that imitates what they have to do.
    """
    problem, z = settled_in_own_units(noise, screened.problem, screened.z)
    # what is stated of parameters and of what differs by trial costs as much beside the data as it does there
    squares = problem.squares(z) * _of_data(screened.problem, z) / max(_of_data(problem, z), 1e-300)
    return replace(screened, z=z, squares=squares, gain=max(base.squares - squares, 0.0)), problem


def _of_data(problem: Problem, z: FloatArray) -> float:
    """Return the sum of squared residuals of the samples alone."""
    trials = zip(problem.data.trials, problem.residuals(z), strict=True)
    return sum(float(np.sum(np.square(one[: trial.outputs.size]))) for trial, one in trials)


def _conditions(base: Base, screened: Screened) -> float:
    before, gains = np.zeros((2, len(base.problem.data.conditions)))
    after = screened.problem.residuals(screened.z)
    for trial, then, now in zip(base.problem.data.trials, base.residual, after, strict=True):
        before[trial.group] += float(then @ then)
        gains[trial.group] += float(then @ then) - float(now @ now)
    # shares: what is explained in every condition alike is not that of the one that leaves most
    shares = np.maximum(gains, 0.0) / np.where(before > 0.0, before, 1.0)
    squares = float(np.sum(np.square(shares)))
    return float(np.sum(shares)) ** 2 / squares if squares > 0 else 1.0


def score(screened: Screened, threshold: NoiseThreshold) -> float:
    """Return the tempered log likelihood that a candidate adds, less a price for its variables."""
    price = criteria.VARIABLE_PRICE * max(screened.candidate.variables, 1)
    return threshold.log_likelihood(threshold.less_luck(screened.gain, screened.survey.among)) - price


def promising(
    screened: Sequence[Screened], threshold: NoiseThreshold, most: int, least: float = 0.0
) -> list[Screened]:
    """Return the candidates worth a closer look, best first: those that beat noise, and the best few in any case.

    Parameters
    ----------
    least
        What they have to gain besides, about.
    """
    needed = max(threshold.gain, criteria.RATED_OF_NEEDED * least)
    ordered = sorted(screened, key=lambda one: -score(one, threshold))
    best = score(ordered[0], threshold) if ordered else 0.0
    return [
        one
        for place, one in enumerate(ordered[:most])
        if (place < criteria.RATED_ANYWAY and least == 0.0)
        or (one.gain > needed and score(one, threshold) > criteria.RATED_BESIDE_BEST * best)
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


def preferred(
    rated: Sequence[Rated], left: ExcessResidual, *, least: float = 0.0, relative: bool = False
) -> Rated | None:
    """Return the candidate to take in; the simplest of those that do as well as the best. None if none is needed.

    Parameters
    ----------
    left
        Held-out excess without it.
    least
        Part of it that has to be removed: `least_to_remove` for a further cause, 0 for the first.
    relative
        Whether nothing was repeated.
    """
    passing = [one for one in rated if one.evidence > (_needed(one, left) if relative else 1.0)]
    if least > 0.0:
        passing = [one for one in passing if left.total - one.held_out.total >= least * left.total]
    if not passing:
        return None
    most = max(one.share for one in passing)
    # what fits the seen conditions well and fails on the unseen has learned the wrong thing
    # ... but where all fail there alone, as each of two causes may, how badly they do says little
    # without repeats it is the conditions that say so: one where all fail by far would outweigh all others
    least = most - criteria.SHARE_BEHIND_BEST if most >= criteria.LEAST_SHARE else -np.inf
    first = max(passing, key=lambda one: one.share)
    fair = [
        one for one in passing if one.share >= least or (relative and as_good(first, one) >= criteria.AS_GOOD)
    ]
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


def _needed(one: Rated, left: ExcessResidual) -> float:
    """Return the evidence that is asked for without repeats: more where one condition of several speaks alone.

    What that trial has of its own, a parameter a little off, looks like a cause there.
    """
    alone = len(left.weights) > 1 and one.conditions < criteria.SPEAKS_ALONE
    return criteria.EVIDENCE_ALONE if alone else 1.0


def least_to_remove(
    left: ExcessResidual,
    reference: ExcessResidual,
    beside: int = 1,
    learnable: float = 1.0,
    small: float = criteria.SMALL_GAP,
) -> float:
    """Return the part of what is left that a further cause has to remove to earn its place; above 1, none can.

    Parameters
    ----------
    beside
        How many causes there are already: what two leave is less often a third than what is wrong with their forms.
    learnable
        Part of what one cause leaves that any model could explain: the rest is a noise that no repeats tell.
    small
        Gap from which what one cause leaves is plainly more than noise.
    """
    if left.total <= 0.0 or reference.total <= 0.0:
        return float("inf")
    whole = reference.total / left.total
    ways = [criteria.ANOTHER_SHARE * whole]
    if beside == 1:
        ways.append(max(criteria.NOTICED_SHARE * whole, criteria.NOTICED_OF_LEFT))
    if left.gap >= (small if beside == 1 else criteria.SMALL_GAP):
        ways.append(criteria.SMALL_OF_LEFT)
    if beside == 1 and left.gap * np.sqrt(learnable) >= criteria.SMALL_GAP:
        ways.append(criteria.SMALL_OF_LEFT * learnable)
    return min(ways)


def room_for_more(
    left: ExcessResidual, reference: ExcessResidual, beside: int = 1, small: float = criteria.SMALL_GAP
) -> bool:
    """Tell whether a further cause could earn its place at all: by removing everything that is left."""
    return least_to_remove(left, reference, beside, small=small) <= 1.0


def rivals_of(
    best: Rated, rated: Sequence[Rated], *, relative: bool
) -> tuple[tuple[tuple[Rated, float], ...], float]:
    """Return what cannot be told from the best, most probable first, and the best one's own weight.

    Parameters
    ----------
    relative
        Whether noise is not told by repeats: what is left then is mostly what is wrong with either form, and a
        difference counts as far as withheld conditions agree on it.
    """
    near = [
        one
        for one in rated
        if one.evidence > criteria.RIVAL_EVIDENCE and one.share >= best.share - criteria.RIVAL_SHARE
    ]
    simple = [best] if relative else [best, *near]
    near = [one for one in near if not any(_earns_nothing(one, other) for other in simple)]
    if best not in near:
        near.append(best)
    if relative:  # of two forms that both leave much, the richer one says no more than the simpler one
        near = [one for one in near if one is best or not any(_richer(one, other) for other in near)]
    shares = weights(near, _slack(best))
    if relative:
        most = int(np.argmax(shares))  # not always the best: that may have been taken for its being common
        shares = np.maximum(shares, shares[most] * np.array([as_good(near[most], one) for one in near]))
        shares /= shares.sum()
    own = float(shares[near.index(best)])
    # of what is as probable, what is the same to the data comes first, then the common
    ordered = sorted(
        zip(near, shares, strict=True),
        key=lambda pair: (
            -round(pair[1], 2), not relative and not _the_same(best, pair[0]), rank(pair[0].candidate.name)
        ),
    )  # fmt: skip
    rivals = [(one, float(weight)) for one, weight in ordered if one is not best]
    found = [pair for pair in rivals if pair[1] >= criteria.RIVAL_WEIGHT]
    return tuple(found or _kin(best, rated)), own


def _kin(best: Rated, rated: Sequence[Rated]) -> list[tuple[Rated, float]]:
    """Return what one would mend in the same way: the data hardly ever know which of such forms is nature's.

    The simpler form that the best contains comes first, where it does nearly as well: dry friction before another that
    yields before it slips.
    """
    near = [
        one
        for one in rated
        if family(best.candidate.name, one.candidate.name)
        and one.evidence > criteria.RIVAL_EVIDENCE
        and one.share
        >= best.share - (criteria.SHARE_BEHIND_BEST if _contains(best, one) else criteria.RIVAL_SHARE)
        and not _earns_nothing(one, best)
    ]
    return [(max(near, key=lambda one: (_contains(best, one), one.score)), 0.0)] if near else []


def _contains(rich: Rated, simple: Rated) -> bool:
    """Tell whether a candidate is a richer form of another one at its site; not if each contains the other."""
    one, other = rich.candidate, simple.candidate
    if one.attached is None or other.attached is None or one.name.site != other.name.site:
        return False
    mutual = one.name.effect in other.attached.effect.contains
    return other.name.effect in one.attached.effect.contains and not mutual


def _earns_nothing(rich: Rated, simple: Rated) -> bool:
    """Tell whether a candidate is another one again, in a richer form that earns nothing by what it has more."""
    return _contains(rich, simple) and rich.score <= simple.score


def _richer(one: Rated, other: Rated) -> bool:
    """Tell whether a candidate contains another one at its site that predicts as well.

    Conditions say so, where there are enough of them: where both explain nearly all, shares are the same, though one
    may leave twice what the other does in each of them.
    """
    if not _contains(one, other):
        return False
    if len(one.held_out.weights) < criteria.FEWEST_AGREEING:
        return other.share >= one.share - criteria.SIMPLER_SHARE
    return as_good(one, other) >= criteria.AS_GOOD


def more_common(best: Rated, rated: Sequence[Rated], *, relative: bool) -> Rated:
    """Return the most common of those that explain as much as the best does.

    These are what is the same to the data: a sensor's bias and a constant force. Without repeats also what does hardly
    worse on conditions like the withheld ones, of which one or two tell nothing.
    """
    alike = [
        one
        for one in rated
        if one.evidence > 1.0
        and one.share >= best.share - criteria.SIMPLER_SHARE
        and (_the_same(best, one) or (relative and as_good(best, one) >= criteria.AS_GOOD))
    ]
    return min([best, *alike], key=lambda one: rank(one.candidate.name))


def _the_same(best: Rated, one: Rated) -> bool:
    """Tell whether the data tell two effects apart by less than a single variable's worth."""
    return (
        best.candidate.name.kind == one.candidate.name.kind == "effect"
        and abs(best.score - one.score) < criteria.VARIABLE_PRICE
    )


def as_good(best: Rated, one: Rated) -> float:
    """Return the odds that a candidate does hardly worse than the best on conditions like the withheld ones, at most 1.

    By Student's test of the log ratio of what both leave in each condition; 0 where there are too few.
    """
    if one is best:
        return 1.0
    left, best_left = (np.mean(which.held_out.values, axis=1) for which in (one, best))
    floor = 1e-3 * float(np.max(np.abs(best_left)))
    ratio = np.log(np.maximum(left, floor) / np.maximum(best_left, floor))
    if len(ratio) < criteria.FEWEST_AGREEING:
        return 0.0
    from scipy.stats import ttest_1samp

    worse = float(ttest_1samp(ratio, np.log1p(criteria.HARDLY), alternative="greater").pvalue)
    return min(worse / max(1.0 - worse, 1e-9), 1.0)


def _slack(best: Rated) -> float:
    """Return how far forms are to be believed: where the best one's leaves nothing, what leaves something is not it."""
    return float(np.clip(best.left, *criteria.IDEALISED_FORM))
