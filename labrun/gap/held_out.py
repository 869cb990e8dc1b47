"""What a fit leaves on conditions it never saw."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labrun.fit.descent import minimise
from labrun.fit.problem import Blocks
from labrun.gap import criteria
from labrun.gap.identified import information, unseen
from labrun.gap.problem import own_states

if TYPE_CHECKING:
    from labrun.gap.problem import GapProblem

FloatArray = NDArray[np.float64]


def folds(groups: int) -> list[list[int]]:
    """Return which conditions are left out together: one at a time, at most eight folds."""
    count = min(groups, criteria.MOST_FOLDS)
    return [list(range(fold, groups, count)) for fold in range(count)]


def held_out_residuals(problem: "GapProblem", z: FloatArray) -> list[FloatArray]:
    """Return measured minus simulated of every unit, from fits that did not see its condition.

    Only the unit's own initial states are fitted to it. The size of an effect that shows in the withheld condition
    alone (a level that only the largest motion reaches) cannot be learned from the others: it stays what the fit of
    everything made it, and all else is fitted without that condition. With a single condition nothing can be left out:
    the residual is then that of the fit itself.
    """
    groups = len(problem.units.conditions)
    if groups == 1:
        return _of_fit(problem, z)
    residual: list[FloatArray | None] = [None] * len(problem.units.units)
    everything = range(len(problem.units.units))
    # leaving a condition out moves the fit a little: derivatives taken once show every fold its way
    blocks = problem.blocks(z, central=False)
    known = information(problem, z, blocks)
    for left_out in folds(groups):
        test = [index for index in everything if problem.units.units[index].group in left_out]
        train = [index for index in everything if index not in test]
        shared = _trained(problem, z, train, blocks, known)
        for index, one in zip(test, _tested(problem, z, shared, test, blocks), strict=True):
            residual[index] = one
    return [one for one in residual if one is not None]


def not_withheld(problem: "GapProblem", z: FloatArray, blocks: Blocks) -> tuple[str, ...]:
    """Return a sentence for every size of an effect that stayed as it was where a condition was withheld.

    Parameters
    ----------
    blocks
        Derivatives at `z`.
    """
    groups = len(problem.units.conditions)
    if groups == 1 or not problem.effects:
        return ()
    known = information(problem, z, blocks)
    everything = range(len(problem.units.units))
    found = set()
    for left_out in folds(groups):
        train = [index for index in everything if problem.units.units[index].group not in left_out]
        part = problem.of_units(train)
        start = np.concatenate([z[: problem.size], _own(problem, z, train)])
        stays = unseen(problem, known, information(part, start, _of(blocks, train)))
        found |= {problem.names[variable] for variable in np.flatnonzero(stays)}
    sentences = []
    for name in sorted(found):
        number, _, parameter = name.partition(".")
        one = problem.effects[int(number)]
        sentences.append(
            f"{parameter} of {one.effect.id} at {one.site} shows in one condition only: where that was withheld, it "
            "was not learned from the others"
        )
    return tuple(sentences)


def _of_fit(problem: "GapProblem", z: FloatArray) -> list[FloatArray]:
    trials = problem.dataset.trials
    return [one.outputs - got for one, got in zip(trials, problem.simulated(z), strict=True)]


def _own(problem: "GapProblem", z: FloatArray, chosen: Sequence[int]) -> FloatArray:
    own = own_states(problem, z).reshape(len(problem.units.units), problem.own_size)
    return own[list(chosen)].ravel()


def _of(blocks: Blocks, chosen: Sequence[int]) -> Blocks:
    return Blocks(*([of[index] for index in chosen] for of in (blocks.shared, blocks.own, blocks.residual)))


def _trained(
    problem: "GapProblem", z: FloatArray, train: Sequence[int], blocks: Blocks, known: FloatArray
) -> FloatArray:
    part = problem.of_units(train)
    start = np.concatenate([z[: problem.size], _own(problem, z, train)])
    seen = _of(blocks, train)
    stays = unseen(problem, known, information(part, start, seen))
    shared = z[: problem.size]
    end = minimise(
        part,
        start,
        lower=np.where(stays, shared, problem.lower),
        upper=np.where(stays, shared, problem.upper),
        tolerance=criteria.FOLD_TOLERANCE,
        evaluations=criteria.FOLD_EVALUATIONS,
        central=False,
        derivatives=seen,
        secant=True,
        confirmed=False,
    )
    return end[: problem.size]


def _tested(
    problem: "GapProblem", z: FloatArray, shared: FloatArray, test: Sequence[int], blocks: Blocks
) -> list[FloatArray]:
    part = problem.of_units(test)
    start = np.concatenate([shared, _own(problem, z, test)])
    if problem.own_size:
        start = minimise(
            part,
            start,
            lower=shared,
            upper=shared,
            tolerance=criteria.FOLD_TOLERANCE,
            evaluations=criteria.FOLD_EVALUATIONS,
            central=False,
            derivatives=_of(blocks, test),
            secant=True,
            confirmed=False,
        )
    found = []
    parameters = part.parameters(start)
    for index, trial in enumerate(part.dataset.trials):
        outputs = part.simulate(parameters, index, part.own(start, index))
        if outputs is None:  # what is stiff in this condition only may want shorter steps
            outputs = part.finer(criteria.FINER_STEPS).simulate(parameters, index, part.own(start, index))
        # parameters that blow up elsewhere explain nothing there: as bad as predicting the channels' means
        found.append(trial.outputs - (np.mean(trial.outputs, axis=0) if outputs is None else outputs))
    return found
