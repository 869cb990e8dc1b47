"""The integrator's steps, interval by interval: as short as what acts there asks for, and no shorter."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray, IntArray
from labrun.fit import Problem
from labrun.gap import numerics
from labrun.models import Drive, simulate

_FINER = 4
"""Factor by which steps are shortened at a time."""
_FINEST = 16
"""Most steps per sample."""
_QUICK = 3.0
"""Intervals between samples up to which the pace of an effect's own states counts as quick."""
_STEPS_FOLLOW = 0.01
"""Part of the change from one set of steps to the next below which shorter steps change nothing more."""
_STEPS_STAY = 0.5
"""Part of the allowed change of the squares that trials which keep longer steps may make up together."""
_STEPS_STAY_IN_BASE = 0.1
"""The same where the steps of the model without causes are chosen."""
_SHORT_PARTS = (1 / 16, 1 / 8, 1 / 4, 1 / 2)
"""Parts of a trial in which steps are shortened, tried from the smallest."""
_SHORT_BESIDE = 2
"""Intervals on both sides of a shortened one that are shortened, too."""


def in_steps_for(problem: Problem, z: FloatArray) -> tuple[Problem, list[FloatArray] | None]:
    """Return the problem with steps short enough that `z` simulates, and the residuals there; None if none are.

    What is quick beside the integrator's steps, such as a short delay in a loop or a stiff force, wants shorter ones.
    """
    residuals = problem.finite_residuals(z)
    if residuals is None:
        finer = _in_finer_steps(problem)
        residuals = None if finer is problem else finer.finite_residuals(z)
        problem = problem if residuals is None else finer
    return problem, residuals


def in_steps_that_follow(
    problem: Problem, z: FloatArray, before: Sequence[FloatArray], pace_s: float
) -> tuple[Problem, list[FloatArray] | None]:
    """Return `in_steps_for`, in steps that also follow what goes at a pace of its own that is quick beside the samples.

    In steps as long as a delay in a loop, its approximation is finite and another one: it shows nothing of the delay.

    Parameters
    ----------
    before : per trial
        Residuals of what an effect is added to: by what it changes them, steps are judged.
    pace_s
        Of its internal states; infinite where they have none of their own.
    """
    problem, residuals = in_steps_for(problem, z)
    if not _quick(pace_s, problem):
        return problem, residuals
    while residuals is not None and (finer := _in_finer_steps(problem)) is not problem:
        after = finer.finite_residuals(z)
        if after is None or _squares_between(after, residuals) <= _STEPS_FOLLOW * _squares_between(
            after, before
        ):
            break
        problem, residuals = finer, after
    return problem, residuals


def _quick(pace_s: float, problem: Problem) -> bool:
    """Tell whether a pace is quick beside the samples."""
    intervals = [np.diff(trial.time_s) for trial in problem.data.trials] if np.isfinite(pace_s) else []
    return bool(intervals) and pace_s <= _QUICK * float(np.median(np.concatenate(intervals)))


def in_shorter_steps(problem: Problem, z: FloatArray, moved: float) -> Problem:
    """Return the problem in shorter steps in the trials that ask for them at `z`, and there where they matter.

    The problem itself is returned if none do.

    Parameters
    ----------
    moved
        What shorter steps may change the sum of squares by.
    """
    finer = _in_finer_steps(problem)
    if finer is problem:
        return problem
    fine = _squares_by_trial(finer, z)
    change = fine - _squares_by_trial(problem, z)
    if abs(np.sum(change)) < moved:
        return problem
    stays = _staying(change, _STEPS_STAY * moved)
    allowed = _STEPS_STAY * moved / max(int(np.sum(~stays)), 1)
    drives = (
        drive if stay else _short_where_it_matters(problem, finer, z, index, float(fine[index]), allowed)
        for index, (drive, stay) in enumerate(zip(problem.drives, stays, strict=True))
    )
    return problem.with_drives(list(drives))


def in_longer_steps(problem: Problem, z: FloatArray, fewest: Sequence[IntArray]) -> Problem:
    """Return the problem in longer steps in the trials that do not ask for those they have at `z`; itself if all do.

    Parameters
    ----------
    fewest : per trial
        Steps that it takes at least in every interval between samples.
    """
    pairs = zip(problem.steps, fewest, strict=True)
    coarser = problem.with_steps([np.maximum(counts // _FINER, least) for counts, least in pairs])
    if coarser is problem:
        return problem
    before = _squares_by_trial(problem, z)
    change, moved = _squares_by_trial(coarser, z) - before, numerics.STEPS_DO * float(np.sum(before))
    if abs(np.sum(change)) <= moved:
        return coarser
    stays = _staying(change, _STEPS_STAY_IN_BASE * moved)
    both = zip(coarser.drives, problem.drives, stays, strict=True)
    return problem.with_drives([longer if stay else mine for longer, mine, stay in both])


def _in_finer_steps(problem: Problem) -> Problem:
    """Return the problem in shorter steps everywhere; itself if none are to be shorter."""
    few = _FINEST
    return problem.with_steps([np.where(step < few, _FINER * step, step) for step in problem.steps])


def _staying(change: FloatArray, moved: float) -> NDArray[np.bool_]:
    """Tell which trials together change the sum of squares by no more than `moved`: those that change it least."""
    size = np.abs(change)
    order = np.argsort(size)
    stays = np.empty(len(size), dtype=bool)
    stays[order] = np.cumsum(size[order]) <= moved
    return stays


def _short_where_it_matters(
    problem: Problem, finer: Problem, z: FloatArray, index: int, fine: float, allowed: float
) -> Drive:
    """Return a trial's inputs on the finer steps in as few intervals as do: its squares differ by what is allowed.

    Parameters
    ----------
    fine
        Its squares in the finer steps throughout.
    """
    mine, finest = problem.steps[index], finer.steps[index]
    asking = np.where(finest > mine, _asking(problem, finer, z, index), -1.0)
    order = np.argsort(-asking, kind="stable")
    offsets = np.arange(-_SHORT_BESIDE, _SHORT_BESIDE + 1)
    only, z_of_trial = problem.part([index]), np.concatenate([z[: problem.size], problem.own(z, index)])
    for part in _SHORT_PARTS if np.isfinite(asking).all() else ():
        short = order[: int(np.ceil(part * len(order))), None] + offsets
        short, counts = np.clip(short, 0, len(order) - 1), mine.copy()
        counts[short] = finest[short]
        mixed = only.with_steps([counts])
        if abs(_squares_by_trial(mixed, z_of_trial)[0] - fine) <= allowed:
            return mixed.drives[0]
    return finer.drives[index]


def _asking(problem: Problem, finer: Problem, z: FloatArray, index: int) -> FloatArray:
    """Return by how much the finer steps change a trial's states in every interval, in units of what they pass."""
    fine = _course(finer, z, index)
    apart = np.abs(np.diff(fine - _course(problem, z, index), axis=0))
    reach = np.ptp(fine, axis=0)
    return np.asarray(np.max(apart / np.where(reach > 0, reach, 1.0), axis=1, initial=0.0))


def _course(problem: Problem, z: FloatArray, index: int) -> FloatArray:
    """Return a trial's states, or its outputs where the model has none."""
    parameters = problem.parameters(z)
    simulation = simulate(
        problem.model,
        problem.data.trials[index].time_s,
        problem.drives[index],
        parameters=parameters[: len(problem.model.parameters)],
        condition=problem.data.trials[index].condition,
        initial_state=problem.initial_state(index, problem.own(z, index)),
        effects=problem.attached(parameters),
    )
    return simulation.states if problem.model.states else simulation.outputs


def _squares_between(first: Sequence[FloatArray], other: Sequence[FloatArray]) -> float:
    return sum(float(np.sum(np.square(a - b))) for a, b in zip(first, other, strict=True))


def _squares_by_trial(problem: Problem, z: FloatArray) -> FloatArray:
    return np.array([float(residual @ residual) for residual in problem.residuals(z)])
