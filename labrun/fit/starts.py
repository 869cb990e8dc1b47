"""The search for the best parameters: several starts, growing pieces of the trials, then the whole of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.levenberg_marquardt import minimise
from labrun.fit.method import Note
from labrun.fit.problem import Problem

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

    On their way down, parameters keep the sign of their stated value: beyond zero there may be minima that fit as well
    and that nobody can build, such as a negative resistance. A descent that ends at zero is let go on through it:
    there the data demand the other sign.
    """
    stated = problem.priors.stated
    lower = np.where(stated > 0, np.maximum(problem.priors.lower, 0.0), problem.priors.lower)
    upper = np.where(stated < 0, np.minimum(problem.priors.upper, 0.0), problem.priors.upper)

    def descend(
        part: Problem,
        z: FloatArray,
        tolerance: float,
        evaluations: int,
        known: list[Minimum],
        signed: bool = True,
    ) -> FloatArray:
        return minimise(
            part,
            z,
            lower=lower if signed else None,
            upper=upper if signed else None,
            tolerance=tolerance,
            evaluations=evaluations,
            central=False,
            stop=lambda at: _joined(at[: part.size], known) is not None,
        )

    def follow(label: str, start: FloatArray, *, growing: bool) -> Minimum:
        note(f"fitting from {label}")
        z = np.concatenate([start, problem.guess(problem.parameters(start))])
        for share in _GROWTH if growing else ():
            z = descend(problem.beginning(share), z, 1e-3, 12, [])
        z = descend(problem, z, 1e-5, 30, minima)
        shared = z[: problem.size]
        if np.any(
            (shared <= lower) & (lower > problem.priors.lower)
            | (shared >= upper) & (upper < problem.priors.upper)
        ):
            z = descend(problem, z, 1e-5, 30, minima, signed=False)
        return ended(label, z, minima)

    def ended(label: str, z: FloatArray, known: list[Minimum]) -> Minimum:
        same = _joined(z[: problem.size], known)
        return Minimum(label, z, problem.misfit(z)) if same is None else replace(same, label=label)

    minima: list[Minimum] = []
    minima.append(follow("the stated values", stated, growing=False))
    if problem.size and starts > 1:
        minima.append(follow("the stated values, piece by piece", stated, growing=True))
        for number, start in enumerate(_screened(problem, rng, starts - 2), start=1):
            minima.append(follow(f"start {number} of {starts - 2}", start, growing=True))
    # those about as good as the best are followed to their ends, where most of them turn out to be one
    best = min(minimum.misfit for minimum in minima)
    ends: list[Minimum] = []
    for minimum in sorted(minima, key=lambda minimum: minimum.misfit):
        if minimum.misfit <= _ABOUT_AS_GOOD * best:
            z = descend(problem, minimum.z, 1e-7, 40, ends, signed=False)
            ends.append(ended(minimum.label, z, ends))
        else:
            ends.append(minimum)
    return sorted(ends, key=lambda minimum: minimum.misfit)


def _joined(shared: FloatArray, known: Sequence[Minimum]) -> Minimum | None:
    """Return the known minimum whose valley this point lies in."""
    for one in known:
        there = one.z[: len(shared)]
        if np.all(np.abs(shared - there) <= _SAME * np.maximum(np.abs(shared), np.abs(there))):
            return one
    return None


def _screened(problem: Problem, rng: np.random.Generator, wanted: int) -> list[FloatArray]:
    if wanted <= 0:
        return []
    short = problem.beginning(_GROWTH[0])
    rated: list[tuple[float, int, FloatArray]] = []
    for _ in range(8 * wanted):
        start = _draw(problem, rng)
        z = np.concatenate([start, problem.guess(problem.parameters(start))])
        rated.append((short.misfit(z), len(rated), start))
    return [start for _, _, start in sorted(rated, key=lambda one: one[:2])[:wanted]]


def _draw(problem: Problem, rng: np.random.Generator) -> FloatArray:
    stated: FloatArray = problem.priors.stated
    start = stated.copy()
    for index, sigma in enumerate(problem.priors.sigma):
        low, high = problem.priors.lower[index], problem.priors.upper[index]
        if np.isfinite(sigma):
            start[index] = stated[index] + sigma / problem.priors.scale[index] * rng.standard_normal()
        elif stated[index] != 0:
            start[index] = stated[index] * 10.0 ** rng.uniform(-_DECADES, _DECADES)
        elif np.isfinite(low) and np.isfinite(high):
            start[index] = rng.uniform(low, high)
        start[index] = min(max(start[index], low), high)
    return start
