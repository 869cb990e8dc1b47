"""How large an effect can be that the data do not ask for: 95 % bounds from what its changes would leave."""

from collections.abc import Mapping

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import EffectParameter
from labrun.gap import numerics
from labrun.gap.diagnosis import ResampledNumber
from labrun.gap.screening import Base, Screened

_LEVELS_ALIKE = 1.03
"""Levels that differ by less than this factor are as good as one."""


def upper_bounds(screened: Screened, base: Base, units: Mapping[str, str]) -> dict[str, ResampledNumber]:
    """Return how large an effect can be in these data (95 %), in SI: the largest size of what vanishes at zero.

    What cannot be negative, such as a friction, is bounded from zero up. What vanishes at infinity, such as the level
    of a saturation, is bounded by the least level. Residuals count as white noise of standard deviation 1, which the
    units of a fit make them.
    """
    candidate = screened.candidate
    if candidate.attached is None or candidate.scale is None:
        return {}
    size = base.problem.size
    fitted = [parameter for parameter in candidate.attached.effect.parameters if not parameter.held]
    bounds = {}
    norms = np.linalg.norm(screened.survey.directions, axis=0)
    for index, parameter in enumerate(fitted):
        if parameter.neutral != 0.0:
            continue
        per_unit = [
            norm / abs(z[size + index])
            for norm, z in zip(norms, screened.survey.starts, strict=True)
            if z[size + index] != 0 and norm > 0
        ]
        if not per_unit:
            continue
        room = abs(float(screened.z[size + index])) + numerics.NORMAL_95 / float(np.median(per_unit))
        scale = candidate.scale.of(parameter.quantity)
        bound = min(room, max(abs(parameter.lower), abs(parameter.upper))) * scale
        low, high = max(-bound, min(parameter.lower, 0.0) * scale), min(bound, parameter.upper * scale)
        bounds[parameter.name] = ResampledNumber(bound, low, max(high, 0.0), units.get(parameter.name, "1"))
    return bounds | _least_levels(screened, base, units)


def _least_levels(screened: Screened, base: Base, units: Mapping[str, str]) -> dict[str, ResampledNumber]:
    """Return the level below which each parameter that is neutral at infinity would have shown (95 %), in SI.

    A level is excluded where the squared residual, with parameters and initial states following linearly, is by more
    than 1.96^2 above the least that any level leaves. Parameters that are no levels, such as the stiffness
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
    fitted = [parameter for parameter in candidate.attached.effect.parameters if not parameter.held]
    levels = [
        index
        for index, parameter in enumerate(fitted)
        if parameter.neutral is not None and np.isinf(parameter.neutral)
    ]
    if not levels:
        return {}
    search = _Levels(screened, base, fitted, numerics.NORMAL_95**2)
    bounds = {}
    for index in levels:
        parameter = fitted[index]
        level = search.least(index)
        if level is not None:
            scale = candidate.scale.of(parameter.quantity)
            ends = level * scale, _far(parameter) * scale
            bounds[parameter.name] = ResampledNumber(
                ends[0], min(ends), max(ends), units.get(parameter.name, "1")
            )
    return bounds


class _Levels:
    """Levels of one effect, and how much of the data is left unexplained with each; in multiples of what is typical."""

    def __init__(self, screened: Screened, base: Base, fitted: list[EffectParameter], room: float) -> None:
        self._base, self._fitted, self._room = base, fitted, room
        self._problem = screened.problem
        self._shared, self._own = base.z[: base.problem.size], base.problem.own_states(base.z)
        self._before = base.nuisance.remainder(base.residual, base.problem.priors.residual(base.z))
        self._ended = screened.sizes
        self._starts = screened.candidate.starts

    def least(self, index: int) -> float | None:
        """Return the farthest level that the data exclude together with all below it; None if there is none."""
        far = _far(self._fitted[index])
        near = min((start[index] for start in self._starts), key=abs)
        others = self._least_shown(index, near)
        best, least_squares = far, self._remaining(others, index, far)
        ended = float(self._ended[index])
        if abs(near) < abs(ended) < abs(far):
            squares = self._remaining(others, index, ended)
            best, least_squares = (ended, squares) if squares < least_squares else (best, least_squares)
        limit = least_squares + self._room
        if not self._remaining(others, index, near) > limit:
            parameter = self._fitted[index]
            best, near = near, min(parameter.lower, parameter.upper, key=abs)
            if not self._remaining(others, index, near) > limit:
                return None
        while abs(best) > _LEVELS_ALIKE * abs(near):
            between = float(np.sign(near) * np.sqrt(near * best))
            if self._remaining(others, index, between) > limit:
                near = between
            else:
                best = between
        return near

    def _least_shown(self, index: int, level: float) -> FloatArray:
        """Return sizes of all parameters with which the level at `index` changes the data least."""
        start = next(start for start in self._starts if start[index] == level)
        sizes = np.array(start, dtype=float)
        free = []
        for other, parameter in enumerate(self._fitted):
            if other == index:
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
                tried.append((self._remaining(sizes, index, level), value))
            sizes[other] = min(tried)[1]
        return sizes

    def _remaining(self, sizes: FloatArray, index: int, level: float) -> float:
        """Return the sum of squares that is left with a level, less what recalibration can take."""
        sizes = sizes.copy()
        sizes[index] = level
        z = np.concatenate([self._shared, sizes, self._own])
        parts = [
            after - now for after, now in zip(self._problem.residuals(z), self._base.residual, strict=True)
        ]
        return float(np.sum(np.square(self._before + self._base.nuisance.remainder(parts))))


def _far(parameter: EffectParameter) -> float:
    return parameter.upper if parameter.neutral is not None and parameter.neutral > 0 else parameter.lower
