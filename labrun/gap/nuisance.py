"""Nuisance parameters: what recalibration and initial states can imitate, and what is known once they have adapted."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.fit import Jacobian, NormalEquations, Problem
from labrun.gap import criteria, numerics

_RIDGE = 1e-12


class NuisanceProjection:
    """Projection onto what no small change of parameters and initial states can imitate.

    A parameter of stated tolerance takes up only as much as its tolerance allows: its prior counts as one measurement
    more (a row behind the data).

    Parameters
    ----------
    problem, z
        Where the derivatives are taken.
    residual
        Whitened, of every unit there.
    """

    def __init__(self, problem: Problem, z: FloatArray, residual: list[FloatArray]) -> None:
        jacobian = problem.jacobian(z, residual)
        self._own = [basis(own) for own in jacobian.own]
        prior = np.diag(problem.priors.slope)
        # what stands at a bound has given what it can
        shared = z[: problem.size]
        moving = (shared > problem.priors.lower) & (shared < problem.priors.upper)
        rows = [off(own, block[:, moving]) for own, block in zip(self._own, jacobian.shared, strict=True)]
        self._rows, prior = len(prior), prior[:, moving]
        self._shared = basis(np.concatenate([*rows, prior]))
        self.jacobian = jacobian

    def remainder(self, parts: Sequence[FloatArray], prior: FloatArray | None = None) -> FloatArray:
        """Return what is left of residuals, or of a change of them (one array per unit), as one vector.

        Parameters
        ----------
        prior
            Residuals of the prior; zero if None.
        """
        rows = [off(own, part) for own, part in zip(self._own, parts, strict=True)]
        behind = np.zeros((self._rows, *rows[0].shape[1:])) if prior is None else prior
        return off(self._shared, np.concatenate([*rows, behind]))


def basis(columns: FloatArray) -> FloatArray:
    """Return orthonormal columns that span the same space, without what is only rounding."""
    if columns.shape[1] == 0:
        return columns
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0] / norms[norms > 0]
    if columns.shape[1] == 0:
        return columns
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    kept: FloatArray = left[:, singular > numerics.SPANNED * singular[0]]
    return kept


def off(span: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (rows,) or (rows, k) without what orthonormal columns span."""
    return values - span @ (span.T @ values)


def information(problem: Problem, z: FloatArray, jacobian: Jacobian) -> FloatArray:
    """Return the information about every shared variable, parameters and initial states adapting, shape (p,).

    It is the inverse of the variance that the variable would have in units of white noise.
    """
    equations = NormalEquations.of(problem, z, jacobian)
    reduced = equations.shared
    if equations.own.shape[1]:
        own = equations.own + _RIDGE * np.eye(equations.own.shape[1])
        reduced = reduced - np.einsum("tqp,tqr->pr", equations.mixed, np.linalg.solve(own, equations.mixed))
    size = np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    correlation = reduced / np.outer(size, size) + _RIDGE * np.eye(len(size))
    bits: FloatArray = size**2 / np.maximum(np.diag(np.linalg.inv(correlation)), 1.0)
    return bits


def unseen(problem: Problem, whole: FloatArray, part: FloatArray) -> NDArray[np.bool_]:
    """Tell which variables are sizes of effects that a part of the data knows next to nothing of, shape (p,).

    Parameters
    ----------
    whole, part : (p,)
        `information` of all data, and of the part.
    """
    effects = sum(
        not parameter.held for attached in problem.effects for parameter in attached.effect.parameters
    )
    of_effects = np.arange(problem.size) >= problem.size - effects
    weak: NDArray[np.bool_] = of_effects & (part < criteria.LEAST_INFORMATION * whole)
    return weak
