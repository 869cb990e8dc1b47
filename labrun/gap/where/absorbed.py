"""What recalibration takes out of any residual: noise as well as gap."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.gap.where.difference import Difference

FloatArray = NDArray[np.float64]

_RANK = 1e-7


@dataclass(frozen=True)
class _Basis:
    """Directions that are orthonormal once they are whitened.

    Attributes
    ----------
    white : (rows, k)
        Orthonormal.
    plain : (rows, k)
        The same before whitening.
    """

    white: FloatArray
    plain: FloatArray


class Absorbed:
    """Least-squares recalibration, linearised, with the weights it was done with (white noise of each unit's mean).

    Initial states change one unit each: they are taken out unit by unit, and what all units share after that.

    Parameters
    ----------
    difference
        Its `jacobian` says what recalibration can do. All arrays here are in units of `Difference.noise_sd`.
    """

    def __init__(self, difference: Difference) -> None:
        self._whitener = difference.noise.whitener
        self._roots = [float(np.sqrt(unit.count)) for unit in difference.units.trials]
        self._shapes = [one.shape for one in difference.residual]
        sizes = [one.size for one in difference.residual]
        self._ends = np.cumsum(sizes)[:-1]
        none = np.empty((sum(sizes), 0)) if difference.jacobian is None else difference.jacobian
        parts = [
            part / np.tile(difference.noise_sd, shape[0])[:, None]
            for part, shape in zip(np.split(none, self._ends), self._shapes, strict=True)
        ]
        moves = np.array([np.any(part != 0, axis=0) for part in parts]).reshape(len(parts), -1)
        single = moves.sum(axis=0) == 1
        self._own = [
            self._basis_of_unit(part[:, single & there], unit)
            for unit, (part, there) in enumerate(zip(parts, moves, strict=True))
        ]
        self._shared = self._basis_of_all([part[:, moves.any(axis=0) & ~single] for part in parts])

    @property
    def rank(self) -> int:
        """Number of directions that recalibration has."""
        return int(sum(one.white.shape[1] for one in self._own) + self._shared.white.shape[1])

    @property
    def span(self) -> FloatArray:
        """All directions of the white world, orthonormal columns, (all numbers, rank)."""
        from scipy.linalg import block_diag

        return np.concatenate([block_diag(*[one.white for one in self._own]), self._shared.white], axis=1)

    def white(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return values of every unit (n, m) as white noise of standard deviation 1, in one vector."""
        return np.concatenate([self._white(one, unit) for unit, one in enumerate(values)])

    def left(self, values: Sequence[FloatArray]) -> list[FloatArray]:
        """Return what recalibration leaves of values of every unit (n, m)."""
        if self.rank == 0:
            return list(values)
        white = [self._white(one, unit) for unit, one in enumerate(values)]
        along = [own.white.T @ one for own, one in zip(self._own, white, strict=True)]
        # what is shared is orthogonal to what is each unit's own
        together = self._shared.plain @ (self._shared.white.T @ np.concatenate(white))
        return [
            one - (own.plain @ size + part).reshape(one.shape)
            for one, own, size, part in zip(
                values, self._own, along, np.split(together, self._ends), strict=True
            )
        ]

    def _white(self, values: FloatArray, unit: int) -> FloatArray:
        return self._whitener.white(values.reshape(self._shapes[unit])).ravel() * self._roots[unit]

    def _whitened(self, columns: FloatArray, unit: int) -> FloatArray:
        if columns.shape[1] == 0:
            return columns
        return np.stack([self._white(column, unit) for column in columns.T], axis=1)

    def _basis_of_unit(self, columns: FloatArray, unit: int) -> _Basis:
        return _basis(self._whitened(columns, unit), columns)

    def _basis_of_all(self, parts: Sequence[FloatArray]) -> _Basis:
        white, plain = [], []
        for unit, (own, part) in enumerate(zip(self._own, parts, strict=True)):
            whitened = self._whitened(part, unit)
            along = own.white.T @ whitened
            white.append(whitened - own.white @ along)
            plain.append(part - own.plain @ along)
        return _basis(np.concatenate(white), np.concatenate(plain))


def _basis(white: FloatArray, plain: FloatArray) -> _Basis:
    """Return orthonormal directions of whitened columns, without what is only rounding."""
    norms = np.linalg.norm(white, axis=0)
    kept = norms > _RANK * float(np.max(norms, initial=0.0))
    if not np.any(kept):
        return _Basis(white[:, :0], plain[:, :0])
    left, singular, right = np.linalg.svd(white[:, kept] / norms[kept], full_matrices=False)
    rank = singular > _RANK * singular[0]
    return _Basis(left[:, rank], (plain[:, kept] / norms[kept]) @ (right[rank].T / singular[rank]))
