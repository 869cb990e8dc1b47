"""How sure a difference of two units is, from how their trials scatter."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Problem
from labrun.gap import criteria
from labrun.gap.nuisance import basis, off
from labrun.gap.unit_pair import FIRST, SECOND, UNIT


@dataclass(frozen=True)
class _Piece:
    """A trial, or a block of one, at a fit: J'J and J'r of the shared variables, its own states eliminated."""

    unit: str
    fold: int
    information: FloatArray
    pull: FloatArray


def _pieces(problem: Problem, z: FloatArray) -> list[_Piece]:
    """Return the trials of both units, in blocks where there are fewer than eight; a fold is a trial, or its block."""
    jacobian = problem.jacobian(z)
    units = [one.condition[UNIT] for one in problem.data.trials]
    found: list[_Piece] = []
    for unit in (FIRST, SECOND):
        members = [index for index, one in enumerate(units) if one == unit]
        cuts = max(-(-criteria.FEWEST_UNIT_PIECES // len(members)), 1)
        for index in members:
            span = basis(jacobian.own[index])
            shared, residual = off(span, jacobian.shared[index]), off(span, jacobian.residual[index])
            blocks = zip(np.array_split(shared, cuts), np.array_split(residual, cuts), strict=True)
            for block, (one, part) in enumerate(blocks):
                fold = index if len(members) > 1 else len(units) + len(found) + block
                found.append(_Piece(unit, fold, one.T @ one, one.T @ part))
    return found


def scatter_of_trials(problem: Problem, z: FloatArray) -> tuple[FloatArray, int]:
    """Return standard deviations of the scaled variables from the scatter of trials, and their degrees of freedom.

    Few trials agree by chance: a deviation is not below that of white residuals of the size that is left.
    """
    pieces = _pieces(problem, z)
    prior = np.diag(problem.priors.slope**2)
    meat = prior.copy()  # what is stated is a measurement, too, and scatters as it says
    for unit in (FIRST, SECOND):
        pulls = np.array([one.pull for one in pieces if one.unit == unit])
        meat += pulls.T @ pulls * len(pulls) / (len(pulls) - 1)
    bread = _inverse(prior + sum(one.information for one in pieces))
    samples = sum(one.outputs.size for one in problem.data.trials) - problem.size
    dispersion = problem.squares(z) / max(samples, 1)
    variance = np.maximum(np.diag(bread @ meat @ bread), dispersion * np.diag(bread))
    return np.sqrt(np.maximum(variance, 1e-300)), max(len(pieces) - 2, 1)


def _inverse(matrix: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    around = np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(matrix * around, rcond=1e-12, hermitian=True) * around)


def kept_unseen(problem: Problem, z: FloatArray, added: int) -> float:
    """Return the part of its gain that a difference keeps on trials it did not see, in the linear model at its fit.

    Each trial in turn is left to the others, once with the `added` last variables and once without them.
    """
    pieces = _pieces(problem, z)
    prior = np.diag(problem.priors.slope**2)
    kept = np.arange(problem.size - added)
    gone = -z[problem.size - added : problem.size]

    def step(chosen: Sequence[_Piece], *, without: bool) -> FloatArray:
        matrix = prior + sum((one.information for one in chosen), np.zeros_like(prior))
        pull = sum((one.pull for one in chosen), problem.priors.slope * problem.priors.residual(z))
        if not without:
            return np.asarray(-_inverse(matrix) @ pull)
        moved = np.concatenate([np.zeros(len(kept)), gone])
        moved[kept] = -_inverse(matrix[np.ix_(kept, kept)]) @ (pull + matrix @ moved)[kept]
        return moved

    def gain(chosen: Sequence[_Piece], tested: Sequence[_Piece]) -> float:
        steps = [step(chosen, without=without) for without in (True, False)]
        squares = [sum(2.0 * v @ one.pull + v @ one.information @ v for one in tested) for v in steps]
        return float(squares[0] - squares[1])

    folds = sorted({one.fold for one in pieces})
    unseen = sum(
        gain([one for one in pieces if one.fold != fold], [one for one in pieces if one.fold == fold])
        for fold in folds
    )
    return unseen / max(gain(pieces, pieces), 1e-300)
