"""What recalibration can imitate: the directions in which parameters and initial states move the outputs."""

from collections.abc import Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.problem import Problem
from labrun.gap import criteria


class Absorption:
    """Projection onto what no small change of parameters and initial states can imitate.

    A parameter of stated tolerance absorbs only as much as its tolerance allows: its prior counts as one measurement
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
        rows = [_off(own, block[:, moving]) for own, block in zip(self._own, jacobian.shared, strict=True)]
        self._rows, prior = len(prior), prior[:, moving]
        self._shared = basis(np.concatenate([*rows, prior]))
        self.jacobian = jacobian

    def left(self, parts: Sequence[FloatArray], prior: FloatArray | None = None) -> FloatArray:
        """Return what is left of residuals, or of a change of them (one array per unit), as one vector.

        Parameters
        ----------
        prior
            Residuals of the prior; zero if None.
        """
        rows = [_off(own, part) for own, part in zip(self._own, parts, strict=True)]
        behind = np.zeros((self._rows, *rows[0].shape[1:])) if prior is None else prior
        return _off(self._shared, np.concatenate([*rows, behind]))


def basis(columns: FloatArray) -> FloatArray:
    """Return orthonormal columns that span the same space, without what is only rounding."""
    if columns.shape[1] == 0:
        return columns
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0] / norms[norms > 0]
    if columns.shape[1] == 0:
        return columns
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    kept: FloatArray = left[:, singular > criteria.SPANNED * singular[0]]
    return kept


def _off(span: FloatArray, values: FloatArray) -> FloatArray:
    return values - span @ (span.T @ values)
