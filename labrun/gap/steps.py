"""The integrator's steps, trial by trial: as short as what acts there asks for, and no shorter."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Problem
from labrun.gap import criteria


def in_steps_for(problem: Problem, z: FloatArray) -> tuple[Problem, list[FloatArray] | None]:
    """Return the problem with steps short enough that `z` simulates, and the residuals there; None if none are.

    What is quick beside the integrator's steps, such as a short delay in a loop or a stiff force, wants shorter ones.
    """
    there = problem.finite_residuals(z)
    if there is None and min(problem.steps) < criteria.FINEST:
        finer = problem.with_steps(problem.finer_steps(criteria.FINER, criteria.FINEST))
        there = finer.finite_residuals(z)
        problem = problem if there is None else finer
    return problem, there


def in_shorter_steps(problem: Problem, z: FloatArray, moved: float) -> Problem:
    """Return the problem in shorter steps in the trials that ask for them at `z`; itself if none do.

    Parameters
    ----------
    moved
        What shorter steps may change the sum of squares by.
    """
    finer = problem.with_steps(problem.finer_steps(criteria.FINER, criteria.FINEST))
    if finer.steps == problem.steps:
        return problem
    change = _squares_by_trial(finer, z) - _squares_by_trial(problem, z)
    if abs(np.sum(change)) < moved:
        return problem
    return _in_steps_where(problem, finer, change, criteria.STEPS_STAY * moved)


def in_longer_steps(problem: Problem, z: FloatArray, fewest: Sequence[int]) -> Problem:
    """Return the problem in longer steps in the trials that do not ask for those they have at `z`; itself if all do.

    Parameters
    ----------
    fewest : per trial
        Steps per sample that it takes at least.
    """
    steps = [max(count // criteria.FINER, least) for count, least in zip(problem.steps, fewest, strict=True)]
    coarser = problem.with_steps(steps)
    if coarser.steps == problem.steps:
        return problem
    before = _squares_by_trial(problem, z)
    change, moved = _squares_by_trial(coarser, z) - before, criteria.STEPS_DO * float(np.sum(before))
    if abs(np.sum(change)) <= moved:
        return coarser
    found = _in_steps_where(coarser, problem, change, criteria.STEPS_STAY_IN_BASE * moved)
    return problem if found.steps == problem.steps else found


def _in_steps_where(problem: Problem, other: Problem, change: FloatArray, moved: float) -> Problem:
    """Return the problem in the steps of another one, but for trials that together change by no more than `moved`.

    Parameters
    ----------
    change : (trials,)
        What the steps of the other change the sum of squares of each trial by.
    """
    size = np.abs(change)
    order = np.argsort(size)
    stays = np.empty(len(size), dtype=bool)
    stays[order] = np.cumsum(size[order]) <= moved
    drives = zip(problem.drives, other.drives, stays, strict=True)
    return replace(problem, drives=tuple(mine if stay else theirs for mine, theirs, stay in drives))


def _squares_by_trial(problem: Problem, z: FloatArray) -> FloatArray:
    return np.array([float(one @ one) for one in problem.residuals(z)])
