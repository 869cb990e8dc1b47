"""Regression on chosen terms: the terms of signals, and their least squares with conditioning, errors and intervals."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.fit.resampling import resample_trials
from labrun.toml import suggest

BASKETS: dict[str, list[str]] = {
    "a,b": ["a", "b"],
    "+a',b'": ["a", "b", "a'", "b'"],
    "+a'',b''": ["a", "b", "a'", "b'", "a''", "b''"],
    "+a^2,b^2": ["a", "b", "a^2", "b^2"],
    "+a^3,b^3": ["a", "b", "a^2", "b^2", "a^3", "b^3"],
    "+a^4,b^4": ["a", "b", "a^2", "b^2", "a^3", "b^3", "a^4", "b^4"],
    "a,a',a^2,b,b',b^2": ["a", "a'", "a^2", "b", "b'", "b^2"],
}
"""Those of Table 5.3."""
_FACTOR = re.compile(r"([A-Za-z_]\w*)('{0,4})(?:\^([1-9]))?")
_COLLINEAR = 1e-6
"""Singular values of the scaled columns below this share of the largest count as zero."""


def term_values(term: str, signals: Mapping[str, FloatArray], step_s: float) -> FloatArray:
    """Return a term's values, (n,); derivatives are per second, by central differences.

    Raises RequestError: a term that cannot be read, or a signal that is not among the inputs.
    """
    values = np.ones(len(next(iter(signals.values()))))
    for factor in term.replace(" ", "").split("*"):
        found = _FACTOR.fullmatch(factor)
        if found is None:
            raise RequestError(
                f"a basket has a term that cannot be read: {term!r}",
                hint="terms are like a, a', a'', a^2, a*b",
            )
        name, primes, power = found.groups()
        if name not in signals:
            raise RequestError(
                f"a basket's term {term!r} needs {name}, which is not among the inputs",
                hint=suggest(name, signals, kind="inputs"),
            )
        one = signals[name]
        for _ in primes:
            one = np.gradient(one, step_s, edge_order=2)
        values = values * one ** int(power or 1)
    return values


def coefficient_unit(term: str, output_unit: str, units: Mapping[str, str]) -> str:
    """Return the unit of a term's coefficient."""
    below = []
    seconds = 0
    for factor in term.replace(" ", "").split("*"):
        name, primes, power = _FACTOR.fullmatch(factor).groups()  # type: ignore[union-attr]
        below.append(f"{units.get(name, '1')}{'^' + power if power else ''}")
        seconds += len(primes) * int(power or 1)
    above = f" s{'^' + str(seconds) if seconds > 1 else ''}" if seconds else ""
    return f"{output_unit}{above}/{' '.join(below) if len(below) == 1 else '(' + ' '.join(below) + ')'}"


@dataclass(frozen=True, slots=True)
class Regression:
    """The least squares of one output on one set of terms.

    `mae_fold` (k,) holds the mean absolute error on each left-out group; `low` and `high` (p,) the 95 % intervals.
    """

    coefficients: FloatArray
    low: FloatArray
    high: FloatArray
    fitted: FloatArray
    mae: float
    rmse: float
    mae_fold: FloatArray
    aicc: float

    @property
    def cv(self) -> float:
        """Cross-validated mean absolute error."""
        return float(np.mean(self.mae_fold))

    @property
    def cv_error(self) -> float:
        """Its standard error over the groups."""
        return float(np.std(self.mae_fold, ddof=1) / np.sqrt(len(self.mae_fold)))


def condition(matrix: FloatArray) -> float:
    """Return cond(X'X) of unscaled columns as the square of cond(X), which does not lose digits by the product."""
    values = np.linalg.svd(matrix, compute_uv=False)
    return float("inf") if values[-1] <= 0 else float((values[0] / values[-1]) ** 2)


def solve(matrix: FloatArray, values: FloatArray, rcond: float = _COLLINEAR) -> FloatArray:
    """Return the least-squares coefficients of columns of any size, the shortest ones where they are collinear.

    `rcond`: singular values of the scaled columns below this share of the largest count as zero.
    """
    size = np.linalg.norm(matrix, axis=0)
    size = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.lstsq(matrix / size, values, rcond=rcond)[0] / size)


def collinear(matrix: FloatArray, names: Sequence[str]) -> tuple[int, list[str]]:
    """Return the rank of scaled columns, and which terms each lost direction consists of."""
    size = np.linalg.norm(matrix, axis=0)
    _, values, rows = np.linalg.svd(matrix / np.where(size > 0, size, 1.0), full_matrices=False)
    lost = values <= _COLLINEAR * values[0]
    told = [
        " and ".join(name for name, share in zip(names, row, strict=True) if abs(share) > 0.1)
        for row in rows[lost]
    ]
    return int(np.count_nonzero(~lost)), told


def regress(
    matrix: FloatArray, values: FloatArray, groups: NDArray[np.int64], rng: np.random.Generator
) -> Regression:
    """Fit, leave each group out in turn, and resample whole groups.

    Parameters
    ----------
    matrix : (n, p)
    values : (n,)
    groups : (n,)
        Number of the trial, or of the block of time, that a sample belongs to.
    """
    found = solve(matrix, values)
    fitted = matrix @ found
    left = values - fitted
    numbers = np.unique(groups)
    folds = []
    size = np.where((norm := np.linalg.norm(matrix, axis=0)) > 0, norm, 1.0)
    # in the scaled columns' singular directions; those that are lost stay where they are
    _, singular, rows = np.linalg.svd(matrix / size, full_matrices=False)
    kept = rows[singular > _COLLINEAR * singular[0]]
    basis = (matrix / size) @ kept.T
    information, score = [], []
    for number in numbers:
        out = groups == number
        folds.append(float(np.mean(np.abs(values[out] - matrix[out] @ solve(matrix[~out], values[~out])))))
        information.append(basis[out].T @ basis[out])
        score.append(basis[out].T @ left[out])
    draws = resample_trials(np.array(information), np.array(score), rng=rng).draws @ kept / size
    low, high = np.percentile(draws, [2.5, 97.5], axis=0)
    # groups, not samples, count as independent: neighbouring samples share their noise
    count, free = len(numbers), len(kept) + 1
    square = float(np.mean(left**2))
    spare = count - free - 1
    aicc = count * np.log(max(square, 1e-300)) + 2 * free * count / spare if spare > 0 else float("inf")
    return Regression(
        found,
        found + np.minimum(low, 0.0),
        found + np.maximum(high, 0.0),
        fitted,
        float(np.mean(np.abs(left))),
        float(np.sqrt(square)),
        np.array(folds),
        float(aicc),
    )
