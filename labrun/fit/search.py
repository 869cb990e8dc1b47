"""The search for the best parameters: several starts, growing pieces of the trials, then scipy's trust region."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.fit.notes import Note
from labrun.fit.problem import Blocks, Problem

FloatArray = NDArray[np.float64]

_DENSE_LIMIT = 20_000_000
"""Numbers in a dense Jacobian (160 MB); above it the block structure is handed over as a sparse matrix."""
_GROWTH = (0.1, 0.35)
"""Shares of every trial that a distant start is fitted to first: over a short time there are few false minima."""
_DECADES = 0.5
"""Starts of a free parameter lie within this many decades of its stated value."""


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where one start ended."""

    label: str
    z: FloatArray
    misfit: float


def minimise(
    problem: Problem, z: FloatArray, *, tolerance: float = 1e-10, evaluations: int = 60
) -> FloatArray:
    """Return the nearest minimum of the squared residuals and the prior (scipy's trust-region reflective method)."""
    from scipy.optimize import least_squares

    if len(z) == 0:
        return z
    lower, upper = _bounds(problem)

    def residual(x: FloatArray) -> FloatArray:
        return np.concatenate([*problem.residuals(x), problem.prior_residual(x)])

    def jacobian(x: FloatArray) -> Any:
        return _stack(problem, problem.blocks(x))

    result = least_squares(
        residual,
        np.clip(z, lower, upper),
        jac=jacobian,
        bounds=(lower, upper),
        method="trf",
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=1e-14,
        max_nfev=evaluations,
    )
    return np.asarray(result.x, dtype=float)


def search(problem: Problem, rng: np.random.Generator, *, starts: int, note: Note) -> list[Minimum]:
    """Return the minima that several starts lead to, best first.

    The stated values are one start, used directly and once more through growing pieces of the trials. The others
    are drawn log-uniformly around the stated values (uniformly between finite bounds for a stated zero), screened by
    their misfit on short pieces, and the best of them followed.
    """
    stated = problem.values[problem.free] / problem.scale
    minima = []

    def follow(label: str, start: FloatArray, *, growing: bool) -> None:
        note(f"fitting from {label}")
        z = np.concatenate([start, problem.guess(problem.parameters(start))])
        for share in _GROWTH if growing else ():
            z = minimise(problem.beginning(share), z, tolerance=1e-5, evaluations=15)
        z = minimise(problem, z, tolerance=1e-7, evaluations=40)
        minima.append(Minimum(label, z, problem.misfit(z)))

    follow("the stated values", stated, growing=False)
    if problem.size and starts > 1:
        follow("the stated values, piece by piece", stated, growing=True)
        for number, start in enumerate(_screened(problem, rng, starts - 2), start=1):
            follow(f"start {number} of {starts - 2}", start, growing=True)
    return sorted(minima, key=lambda minimum: minimum.misfit)


def _screened(problem: Problem, rng: np.random.Generator, wanted: int) -> list[FloatArray]:
    if wanted <= 0:
        return []
    short = problem.beginning(_GROWTH[0])
    rated: list[tuple[float, int, FloatArray]] = []
    for _ in range(8 * wanted):
        start = _draw(problem, rng)
        z = np.concatenate([start, problem.guess(problem.parameters(start))])
        rated.append((short.misfit(z), len(rated), start))
    return [start for _, _, start in sorted(rated, key=_rank)[:wanted]]


def _rank(rated: tuple[float, int, FloatArray]) -> tuple[float, int]:
    return rated[0], rated[1]


def _draw(problem: Problem, rng: np.random.Generator) -> FloatArray:
    stated: FloatArray = problem.values[problem.free] / problem.scale
    start = stated.copy()
    for index, sigma in enumerate(problem.prior_sigma):
        low, high = problem.lower[index], problem.upper[index]
        if np.isfinite(sigma):
            start[index] = stated[index] + sigma / problem.scale[index] * rng.standard_normal()
        elif stated[index] != 0:
            start[index] = stated[index] * 10.0 ** rng.uniform(-_DECADES, _DECADES)
        elif np.isfinite(low) and np.isfinite(high):
            start[index] = rng.uniform(low, high)
        start[index] = min(max(start[index], low), high)
    return start


def _bounds(problem: Problem) -> tuple[FloatArray, FloatArray]:
    own = np.full(len(problem.dataset.trials) * problem.own_size, np.inf)
    lower: FloatArray = np.concatenate([problem.lower, -own])
    upper: FloatArray = np.concatenate([problem.upper, own])
    return lower, upper


def _stack(problem: Problem, blocks: Blocks) -> Any:
    """Return the Jacobian of residuals and prior: an array, or a sparse matrix where that would be too large."""
    from scipy import sparse

    prior = np.zeros((problem.size, problem.size))
    np.fill_diagonal(prior, -problem.prior_weight * problem.scale / problem.pull_sigma)
    own = sum(block.shape[1] for block in blocks.own)
    rows = sum(len(part) for part in blocks.residual) + problem.size
    shared = np.vstack([*blocks.shared, prior])
    if rows * (problem.size + own) > _DENSE_LIMIT:
        columns = sparse.vstack([sparse.block_diag(blocks.own), sparse.csr_matrix((problem.size, own))])
        return sparse.csr_matrix(sparse.hstack([sparse.csr_matrix(shared), columns]))
    matrix = np.zeros((rows, problem.size + own))
    matrix[:, : problem.size] = shared
    row, column = 0, problem.size
    for block in blocks.own:
        matrix[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return matrix
