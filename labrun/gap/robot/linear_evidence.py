"""How well linear models of joint torques predict pieces of time that they were not fitted to.

Everything is computed from Gram matrices, one for each joint and piece of time: a fit without a piece solves the
normal equations without its Gram matrix, and what it leaves of that piece is a quadratic form.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.gap import criteria

_LEAST = 1e-12
"""Mean squared residual, in units of the gap, below which a prediction is exact."""
_RIDGE = 1e-10
"""Precision of columns without a prior, in units of their own squares."""


@dataclass(frozen=True)
class Gram:
    """Squares and products of one joint's rows in every unit of evidence.

    Attributes
    ----------
    columns : (k,)
        Which columns of all these are.
    squares : (units, k, k)
    products : (units, k)
        Of the columns with the torque.
    torque : (units,)
        Squares of the torque.
    count : (units,)
        Number of rows; 0 where the joint rests.
    """

    columns: IntArray
    squares: FloatArray
    products: FloatArray
    torque: FloatArray
    count: FloatArray

    @classmethod
    def of(cls, columns: IntArray, rows: Sequence[FloatArray], torque: Sequence[FloatArray]) -> "Gram":
        """Sum up rows (n, k) and torques (n,), one pair for each unit."""
        return cls(
            columns,
            np.array([part.T @ part for part in rows]),
            np.array([part.T @ right for part, right in zip(rows, torque, strict=True)]),
            np.array([float(right @ right) for right in torque]),
            np.array([float(len(right)) for right in torque]),
        )

    def without_prediction(self, known: FloatArray) -> "Gram":
        """Return the same with the torque less what known coefficients (k,) of its columns make."""
        by_known = self.squares @ known
        torque = self.torque - 2.0 * self.products @ known + by_known @ known
        return replace(self, products=self.products - by_known, torque=np.maximum(torque, 0.0))

    def mean_squares(self, values: FloatArray) -> FloatArray:
        """Return the mean squared residual of every unit, with coefficients (units, k) or (k,); NaN where it rests."""
        values = np.broadcast_to(values, self.products.shape)
        made = (values[:, None, :] @ self.squares)[:, 0, :]
        left = self.torque + np.einsum("uk,uk->u", values, made - 2.0 * self.products)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean: FloatArray = np.maximum(left, 0.0) / self.count
        return mean


@dataclass(frozen=True)
class LinearEvidence:
    """All that linear models of a log are judged by.

    Attributes
    ----------
    grams
        Of every joint that is looked at.
    strata : (units,)
        Number of the condition of each unit.
    precision : (columns,)
        Inverse square of how far each coefficient may be from zero; 0 for what is free.
    weights : (joints,)
        Of each joint's squares in a fit: independent numbers per row, over the variance of what is left.
    """

    grams: tuple[Gram, ...]
    strata: IntArray
    precision: FloatArray
    weights: FloatArray

    @property
    def units(self) -> int:
        """How many units of evidence there are."""
        return len(self.strata)

    @cached_property
    def ridge(self) -> FloatArray:
        """Precision of every column, with enough for those without a prior to be solvable."""
        diagonal = np.zeros(len(self.precision))
        for gram, weight in zip(self.grams, self.weights, strict=True):
            diagonal[gram.columns] += weight * np.einsum("ukk->k", gram.squares)
        return self.precision + _RIDGE * diagonal + 1e-300

    def normal(self, units: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the normal equations with every unit counted so often, without priors."""
        size = len(self.precision)
        matrix, right = np.zeros((size, size)), np.zeros(size)
        for gram, weight in zip(self.grams, self.weights, strict=True):
            index = np.ix_(gram.columns, gram.columns)
            matrix[index] += weight * np.tensordot(units, gram.squares, 1)
            right[gram.columns] += weight * (units @ gram.products)
        return matrix, right

    def fit(
        self, active: IntArray, units: FloatArray | None = None, prior: FloatArray | None = None
    ) -> FloatArray:
        """Return the coefficients of all columns, (columns,); those that are not active are 0.

        Parameters
        ----------
        units : (units,)
            How often each counts; once if None.
        prior : (columns,)
            What each coefficient is believed to be; 0 if None.
        """
        matrix, right = self.normal(np.ones(self.units) if units is None else units)
        ridge = self.ridge[active]
        right = right[active] + (0.0 if prior is None else ridge * prior[active])
        values = np.zeros(len(self.precision))
        values[active] = _solve(matrix[np.ix_(active, active)] + np.diag(ridge), right)
        return values

    def resampled(self, active: IntArray, drawn: IntArray, rng: np.random.Generator) -> FloatArray:
        """Return the coefficients (draws, active) of fits to resampled units and redrawn stated values.

        Parameters
        ----------
        drawn : (draws, units)
            Units of each draw, as `labrun.gap.decide.resamples` returns them.
        """
        each = [self.normal(row) for row in np.eye(self.units)]
        matrices = np.array([matrix[np.ix_(active, active)] for matrix, _ in each])
        rights = np.array([right[active] for _, right in each])
        ridge = self.ridge[active]
        stated = np.where(
            self.precision[active] > 0.0, np.sqrt(1.0 / np.maximum(self.precision[active], 1e-300)), 0.0
        )
        values = []
        for row in drawn:
            counts = np.bincount(row, minlength=self.units).astype(float)
            prior = stated * rng.standard_normal(len(active))
            matrix = np.tensordot(counts, matrices, 1) + np.diag(ridge)
            values.append(_solve(matrix, counts @ rights + ridge * prior))
        return np.array(values)

    @cached_property
    def _folds(self) -> tuple[FloatArray, FloatArray]:
        folds = [self.normal(1.0 - np.eye(self.units)[unit]) for unit in range(self.units)]
        return np.array([matrix for matrix, _ in folds]), np.array([right for _, right in folds])

    def unseen(self, active: IntArray) -> FloatArray:
        """Return the mean squared residual of every unit and joint by fits without it, (units, joints)."""
        return self._errors(active, self._without(active))

    def _without(self, active: IntArray) -> FloatArray:
        """Return the coefficients (units, active) of the fits without each unit."""
        matrices, rights = self._folds
        normal = matrices[:, active[:, None], active] + np.diag(self.ridge[active])
        return np.array(
            [_solve(matrix, right) for matrix, right in zip(normal, rights[:, active], strict=True)]
        )

    def _errors(
        self, active: IntArray, values: FloatArray, joints: Collection[int] | None = None
    ) -> FloatArray:
        every = np.zeros((self.units, len(self.precision)))
        every[:, active] = values
        return np.column_stack(
            [
                gram.mean_squares(every[:, gram.columns])
                if joints is None or joint in joints
                else np.full(self.units, np.nan)
                for joint, gram in enumerate(self.grams)
            ]
        )

    def unseen_with(
        self, active: IntArray, groups: Sequence[IntArray], joints: Sequence[Collection[int]]
    ) -> list[tuple[FloatArray, FloatArray]]:
        """Return the errors with each of several groups of columns added, by the Schur complement of the active ones.

        Parameters
        ----------
        joints
            At which joints the errors of each group are wanted; they are NaN at all others.

        Returns
        -------
        [((units, joints), (units, group))]
            Mean squared residuals, and the coefficients of the group in each fit.
        """
        if not groups:
            return []
        matrices, rights = self._folds
        added = np.unique(np.concatenate(groups))
        normal = matrices[:, active[:, None], active] + np.diag(self.ridge[active])
        across = matrices[:, active[:, None], added]
        both = np.concatenate([rights[:, active][:, :, None], across], axis=2)
        solved = np.array([_solve(matrix, side) for matrix, side in zip(normal, both, strict=True)])
        base, ways = solved[:, :, 0], solved[:, :, 1:]
        complement = matrices[:, added[:, None], added] - np.swapaxes(across, 1, 2) @ ways
        left = rights[:, added] - np.einsum("uka,uk->ua", across, base)
        numbers = {int(column): number for number, column in enumerate(added)}
        errors = []
        for group, wanted in zip(groups, joints, strict=True):
            rows = np.array([numbers[int(column)] for column in group])
            inner = complement[:, rows[:, None], rows] + np.diag(self.ridge[group])
            new = np.array([_solve(matrix, side) for matrix, side in zip(inner, left[:, rows], strict=True)])
            old = base - np.einsum("uka,ua->uk", ways[:, :, rows], new)
            both = np.concatenate([old, new], axis=1)
            errors.append((self._errors(np.concatenate([active, group]), both, wanted), new))
        return errors

    def reweighed(self, errors: FloatArray, independent: FloatArray) -> "LinearEvidence":
        """Return the same in units of what a model leaves.

        Parameters
        ----------
        errors : (units, joints)
            Mean squared residuals.
        independent : (joints,)
            Independent numbers per row.
        """
        variance = np.array(
            [np.nanmean(column) if np.isfinite(column).any() else np.inf for column in errors.T]
        )
        return replace(self, weights=independent / np.maximum(variance, 1e-300))


def log_errors(errors: FloatArray, joints: Sequence[int], gap: FloatArray) -> FloatArray:
    """Return the log error of every unit in which one of some joints moves, as `labrun.gap.evidence.error_of` does.

    Each joint counts by the logarithm of its mean squared residual, with the error that idealised forms are allowed.

    Parameters
    ----------
    errors : (units, joints)
        Mean squared residuals, NaN where a joint rests.
    gap : (joints,)
        Mean squared residual of each joint that causes are to explain.
    """
    chosen = list(joints)
    form_error = criteria.NEGLIGIBLE**2 * gap[chosen]
    logs = np.log(np.maximum(errors[:, chosen] + form_error, _LEAST * np.maximum(gap[chosen], _LEAST)))
    seen = np.isfinite(logs)
    mean: FloatArray = np.where(seen, logs, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    return mean[seen.any(axis=1)]


def units_of(errors: FloatArray) -> IntArray:
    """Return a stratum for each unit of a table of log errors (..., units): pieces of time stand by themselves."""
    return np.arange(errors.shape[-1])


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve symmetric equations whose columns are of any size."""
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    scaled = matrix * scale * scale[:, None]
    sides = right * (scale if right.ndim == 1 else scale[:, None])
    try:
        solved = cho_solve(cho_factor(scaled, check_finite=False), sides, check_finite=False)
    except LinAlgError:
        solved = np.asarray(np.linalg.lstsq(scaled, sides, rcond=1e-12)[0], dtype=np.float64)
    result: FloatArray = solved * (scale if right.ndim == 1 else scale[:, None])
    return result


def jackknife_error(left_out: FloatArray) -> float:
    """Return the standard error of a coefficient from its fits without one unit each, (units,)."""
    count = len(left_out)
    return float(np.sqrt((count - 1) / count * np.sum(np.square(left_out - left_out.mean()))))
