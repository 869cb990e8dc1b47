"""How sure a cause is, how much it removes, and how large what is ruled out can be."""

from collections.abc import Mapping

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import EffectParameter
from labrun.fit import Dataset
from labrun.gap import criteria
from labrun.gap.diagnosis import ResampledNumber, Shrinkage
from labrun.gap.held_out import ExcessResidual, group_means
from labrun.gap.noise import Basis, Noise
from labrun.gap.pipeline import Search
from labrun.gap.screening import Base, Screened
from labrun.gap.selection import Chosen


def confidence(search: Search, one: Chosen) -> float:
    """Return the probability that a chosen cause, or the first of its rivals, is the right one.

    Their weight among all that explains the data as well, less what even a cause without rivals turned out to be wrong.
    """
    weight = one.weight + (one.rivals[0][1] if one.rivals else 0.0)
    own_share = 1.0 if _explains_most_alone(search, one) else one.own_share
    most = ceiling(search.noise.basis, len(search.data.conditions), own_share)
    no_chance = 1.0 - np.exp(-one.rated.evidence)
    return float(np.clip(most * weight * no_chance, criteria.LEAST_CONFIDENCE, most))


def _explains_most_alone(search: Search, one: Chosen) -> bool:
    """Tell whether no other of the causes removes more by itself.

    Where little comes back without any one of them, they stand in for one another, and this is what they stand in for.
    """
    alone = {rated.candidate.name: rated.share for rated in search.selection.rounds[0].rated}
    most = max((alone.get(other.name, -1.0) for other in search.selection.chosen), default=-1.0)
    return one.name in alone and alone[one.name] >= most


def ceiling(basis: Basis, conditions: int, own_share: float = 1.0) -> float:
    """Return how sure a diagnosis may be of a cause at most: noise not told from gap, or nothing withheld, costs.

    So does a cause that little of the gap would come back without, where repeats show that little: another cause's
    form, which is not nature's, leaves as much.
    """
    little = basis == "repeats" and own_share < criteria.LITTLE_SHARE
    if conditions == 1:
        most = criteria.SURE_OF_ONE_TRIAL if basis == "residual" else criteria.SURE_OF_ONE_CONDITION
    else:
        most = criteria.SURE_WITHOUT_REPEATS if basis == "residual" else criteria.SURE
    return min(criteria.SURE_OF_LITTLE if little else criteria.SURE, most)


def upper_bounds(
    screened: Screened, base: Base, dispersion: float, units: Mapping[str, str]
) -> dict[str, ResampledNumber]:
    """Return how large an effect can be in these data (95 %), in SI: the largest size of what vanishes at zero.

    What cannot be negative, such as a friction, is bounded from zero up. What vanishes at infinity, such as the level
    of a saturation, is bounded by the least level; see `labrun.gap.confidence`.
    """
    screened = screened.usual or screened  # bounds are of the usual form
    candidate = screened.candidate
    if candidate.attached is None or candidate.scale is None:
        return {}
    size = base.problem.size
    fitted = [one for one in candidate.attached.effect.parameters if not one.held]
    found = {}
    norms = np.linalg.norm(screened.survey.directions, axis=0)
    for place, parameter in enumerate(fitted):
        if parameter.neutral != 0.0:
            continue
        per_unit = [
            norm / abs(z[size + place])
            for norm, z in zip(norms, screened.survey.starts, strict=True)
            if z[size + place] != 0 and norm > 0
        ]
        if not per_unit:
            continue
        room = abs(float(screened.z[size + place])) + criteria.NORMAL_95 * np.sqrt(dispersion) / float(
            np.median(per_unit)
        )
        scale = candidate.scale.of(parameter.quantity)
        bound = min(room, max(abs(parameter.lower), abs(parameter.upper))) * scale
        low, high = max(-bound, min(parameter.lower, 0.0) * scale), min(bound, parameter.upper * scale)
        found[parameter.name] = ResampledNumber(bound, low, max(high, 0.0), units.get(parameter.name, "1"))
    return found | least_levels(screened, base, dispersion, units)


def shrinkage(
    data: Dataset, noise: Noise, before: ExcessResidual, after: ExcessResidual, rng: np.random.Generator
) -> Shrinkage:
    """Return the share of the excess that is removed on withheld conditions, with a 90 % interval.

    It says what an experiment of a few new conditions would show: conditions are resampled whole, each with the noise
    that its mean has. Both ends may lie beyond 1, as a measured share may.
    """
    then, now = group_means(data, before.residual), group_means(data, after.residual)
    groups = len(then)
    sizes = np.array([len(mean) for mean, _ in then], dtype=float)
    # without repeats the question is whether anything is removed at all, of all there is
    fresh = min(groups, criteria.NEW_CONDITIONS) if noise.known else groups
    shares = []
    for _ in range(criteria.RESAMPLES):
        drawn = group_means(data, noise.draw(data, rng))
        first, second = np.empty(groups), np.empty(groups)
        for group in range(groups):
            disturbance = drawn[group][0]
            floor = noise.mean_floor(group, then[group][1])
            first[group] = _shaken(then[group][0], disturbance, noise.sd, floor)
            second[group] = _shaken(now[group][0], disturbance, noise.sd, floor)
        chosen = rng.integers(0, groups, fresh)
        total = float(sizes[chosen] @ first[chosen])
        if total > 0:
            shares.append(1.0 - float(sizes[chosen] @ second[chosen]) / total)
    value = 1.0 - after.total / before.total if before.total > 0 else 0.0
    low, high = np.percentile(shares, [5.0, 95.0]) if shares else (value, value)
    value = min(value, 1.0)
    # new conditions ask for more than those between the old ones: forms and parameters are extrapolated
    low = min(low, value) - criteria.FORM_ERROR - criteria.EXTRAPOLATED * max(1.0 - value, 0.0)
    high = max(high, value) + criteria.FORM_ERROR
    return Shrinkage(float(value), float(low), float(high))


def _shaken(mean: FloatArray, drawn: FloatArray, sd: FloatArray, floor: FloatArray) -> float:
    """Return the excess had the noise come out differently; its own square is taken off as twice the floor."""
    length = min(len(mean), len(drawn))
    again = np.mean(np.square((mean[:length] + drawn[:length]) / sd), axis=0) - 2.0 * floor
    return float(np.mean(again))


def least_levels(
    screened: Screened, base: Base, dispersion: float, units: Mapping[str, str]
) -> dict[str, ResampledNumber]:
    """Return the level below which each parameter that is neutral at infinity would have shown (95 %), in SI.

    A level is excluded where the squared residual, with parameters and initial states following linearly, is by more
    than 1.96^2 dispersions above the least that any level leaves. Parameters that are no levels, such as the stiffness
    of a stop, stand where the data show the effect least; levels on another side are out of reach.

    Returns
    -------
    Mapping
        By parameter. `value` is the level, the other end of the interval the farthest level that is looked for. None
        for a parameter of which no level can be excluded.
    """
    candidate = screened.candidate
    if candidate.attached is None or candidate.scale is None:
        return {}
    fitted = [one for one in candidate.attached.effect.parameters if not one.held]
    levels = [place for place, one in enumerate(fitted) if one.neutral is not None and np.isinf(one.neutral)]
    if not levels:
        return {}
    search = _Levels(screened, base, fitted, criteria.NORMAL_95**2 * dispersion)
    found = {}
    for place in levels:
        parameter = fitted[place]
        level = search.least(place)
        if level is not None:
            scale = candidate.scale.of(parameter.quantity)
            ends = level * scale, _far(parameter) * scale
            found[parameter.name] = ResampledNumber(
                ends[0], min(ends), max(ends), units.get(parameter.name, "1")
            )
    return found


class _Levels:
    """Levels of one effect, and how much of the data is left unexplained with each; in multiples of what is typical."""

    def __init__(self, screened: Screened, base: Base, fitted: list[EffectParameter], room: float) -> None:
        self._base, self._fitted, self._room = base, fitted, room
        self._problem = screened.problem
        self._shared, self._own = base.z[: base.problem.size], base.problem.own_states(base.z)
        self._before = base.nuisance.remainder(base.residual, base.problem.priors.residual(base.z))
        self._ended = screened.sizes
        self._starts = screened.candidate.starts

    def least(self, place: int) -> float | None:
        """Return the farthest level that the data exclude together with all below it; None if there is none."""
        far = _far(self._fitted[place])
        near = min((start[place] for start in self._starts), key=abs)
        others = self._least_shown(place, near)
        best, left = far, self._left(others, place, far)
        ended = float(self._ended[place])
        if abs(near) < abs(ended) < abs(far):
            there = self._left(others, place, ended)
            best, left = (ended, there) if there < left else (best, left)
        limit = left + self._room
        if not self._left(others, place, near) > limit:
            parameter = self._fitted[place]
            best, near = near, min(parameter.lower, parameter.upper, key=abs)
            if not self._left(others, place, near) > limit:
                return None
        while abs(best) > criteria.LEVELS_ALIKE * abs(near):
            between = float(np.sign(near) * np.sqrt(near * best))
            if self._left(others, place, between) > limit:
                near = between
            else:
                best = between
        return near

    def _least_shown(self, place: int, level: float) -> FloatArray:
        """Return sizes of all parameters with which the level at `place` changes the data least."""
        start = next(start for start in self._starts if start[place] == level)
        sizes = np.array(start, dtype=float)
        free = []
        for other, parameter in enumerate(self._fitted):
            if other == place:
                continue
            if parameter.neutral is not None and np.isinf(parameter.neutral):
                sizes[other] = _far(parameter)
            else:
                free.append(other)
        for other in free:
            parameter = self._fitted[other]
            tried = []
            for value in (sizes[other], parameter.lower, parameter.upper):
                sizes[other] = value
                tried.append((self._left(sizes, place, level), value))
            sizes[other] = min(tried)[1]
        return sizes

    def _left(self, sizes: FloatArray, place: int, level: float) -> float:
        """Return the sum of squares that is left with a level, less what recalibration can take."""
        sizes = sizes.copy()
        sizes[place] = level
        z = np.concatenate([self._shared, sizes, self._own])
        parts = [
            after - now for after, now in zip(self._problem.residuals(z), self._base.residual, strict=True)
        ]
        return float(np.sum(np.square(self._before + self._base.nuisance.remainder(parts))))


def _far(parameter: EffectParameter) -> float:
    return parameter.upper if parameter.neutral is not None and parameter.neutral > 0 else parameter.lower
