"""The search for the best parameters: several starts, growing pieces of the trials, then the whole of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labrun.fit.descent import minimise
from labrun.fit.notes import Note
from labrun.fit.problem import Problem

FloatArray = NDArray[np.float64]

_GROWTH = (0.1, 0.35)
"""Shares of every trial that a distant start is fitted to first: over a short time there are few false minima."""
_SAME = 0.01
"""Descents whose parameters differ by less than this share are in one valley."""
_ABOUT_AS_GOOD = 1.05
_DECADES = 0.5
"""Starts of a free parameter lie within this many decades of its stated value."""


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where one start ended."""

    label: str
    z: FloatArray
    misfit: float


def search(problem: Problem, rng: np.random.Generator, *, starts: int, note: Note) -> list[Minimum]:
    """Return the minima that several starts lead to, best first, roughly: the best is there to be refined.

    The stated values are one start, used directly and once more through growing pieces of the trials. The others
    are drawn log-uniformly around the stated values (uniformly between finite bounds for a stated zero), screened by
    their misfit on short pieces, and the best of them followed. A descent that comes close to a minimum another one has
    found is taken to end there.

    Parameters keep the sign of their stated value here: beyond zero there may be minima that fit as well and that
    nobody can build, such as a negative resistance. What the data demand shows when the best minimum is refined without
    that limit.
    """
    stated = problem.values[problem.free] / problem.scale
    lower = np.where(stated > 0, np.maximum(problem.lower, 0.0), problem.lower)
    upper = np.where(stated < 0, np.minimum(problem.upper, 0.0), problem.upper)
    minima: list[Minimum] = []

    def joined(z: FloatArray) -> Minimum | None:
        return next((known for known in minima if _close(z[: problem.size], known.z[: problem.size])), None)

    def descend(part: Problem, z: FloatArray, tolerance: float, evaluations: int) -> FloatArray:
        return minimise(
            part,
            z,
            lower=lower,
            upper=upper,
            tolerance=tolerance,
            evaluations=evaluations,
            central=False,
            stop=lambda at: part is problem and joined(at) is not None,
        )

    def follow(label: str, start: FloatArray, *, growing: bool) -> None:
        note(f"fitting from {label}")
        z = np.concatenate([start, problem.guess(problem.parameters(start))])
        for share in _GROWTH if growing else ():
            z = descend(problem.beginning(share), z, 1e-3, 12)
        z = descend(problem, z, 1e-5, 30)
        known = joined(z)
        if known is None:
            minima.append(Minimum(label, z, problem.misfit(z)))
        else:
            minima.append(replace(known, label=label))

    follow("the stated values", stated, growing=False)
    if problem.size and starts > 1:
        follow("the stated values, piece by piece", stated, growing=True)
        for number, start in enumerate(_screened(problem, rng, starts - 2), start=1):
            follow(f"start {number} of {starts - 2}", start, growing=True)
    return _polished(minima, lambda z: descend(problem, z, 1e-7, 40), problem)


def _polished(
    minima: list[Minimum], descend: Callable[[FloatArray], FloatArray], problem: Problem
) -> list[Minimum]:
    """Follow those that are about as good as the best to their ends, where most of them turn out to be one."""
    best = min(minimum.misfit for minimum in minima)
    ends: list[Minimum] = []
    for minimum in sorted(minima, key=lambda minimum: minimum.misfit):
        if minimum.misfit > _ABOUT_AS_GOOD * best:
            ends.append(minimum)
            continue
        same = next((end for end in ends if _close(minimum.z, end.z)), None)
        if same is None:
            z = descend(minimum.z)
            same = next((end for end in ends if _close(z[: problem.size], end.z[: problem.size])), None)
            same = Minimum(minimum.label, z, problem.misfit(z)) if same is None else same
        ends.append(replace(same, label=minimum.label))
    return sorted(ends, key=lambda minimum: minimum.misfit)


def _close(one: FloatArray, other: FloatArray) -> bool:
    return bool(np.all(np.abs(one - other) <= _SAME * np.maximum(np.abs(one), np.abs(other))))


def _screened(problem: Problem, rng: np.random.Generator, wanted: int) -> list[FloatArray]:
    if wanted <= 0:
        return []
    short = problem.beginning(_GROWTH[0])
    rated: list[tuple[float, int, FloatArray]] = []
    for _ in range(8 * wanted):
        start = _draw(problem, rng)
        z = np.concatenate([start, problem.guess(problem.parameters(start))])
        rated.append((short.misfit(z), len(rated), start))
    return [start for _, _, start in sorted(rated, key=_rank)[:wanted]]


def _rank(rated: tuple[float, int, FloatArray]) -> tuple[float, int]:
    return rated[0], rated[1]


def _draw(problem: Problem, rng: np.random.Generator) -> FloatArray:
    stated: FloatArray = problem.values[problem.free] / problem.scale
    start = stated.copy()
    for index, sigma in enumerate(problem.prior_sigma):
        low, high = problem.lower[index], problem.upper[index]
        if np.isfinite(sigma):
            start[index] = stated[index] + sigma / problem.scale[index] * rng.standard_normal()
        elif stated[index] != 0:
            start[index] = stated[index] * 10.0 ** rng.uniform(-_DECADES, _DECADES)
        elif np.isfinite(low) and np.isfinite(high):
            start[index] = rng.uniform(low, high)
        start[index] = min(max(start[index], low), high)
    return start
