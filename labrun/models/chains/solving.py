"""Compiled: small symmetric systems. Importing this imports numba."""

import math

import numpy as np

from labrun.arrays import FloatArray
from labrun.compiled import kernel

_DEPENDENT = 1e-10
"""Share of the largest pivot below which a row depends on those before it."""


@kernel
def factored(matrix: FloatArray) -> bool:
    """Replace a symmetric matrix by its Cholesky factor (lower); tell whether it is positive."""
    size = matrix.shape[0]
    for column in range(size):
        before = matrix[column, column]
        for k in range(column):
            matrix[column, column] -= matrix[column, k] ** 2
        if not matrix[column, column] > 1e-12 * before:
            return False
        matrix[column, column] = math.sqrt(matrix[column, column])
        for row in range(column + 1, size):
            for k in range(column):
                matrix[row, column] -= matrix[row, k] * matrix[column, k]
            matrix[row, column] /= matrix[column, column]
    return True


@kernel
def solved(factor: FloatArray, right: FloatArray) -> None:
    """Replace a right-hand side by the solution, given the factor of `factored`."""
    size = factor.shape[0]
    for row in range(size):
        for k in range(row):
            right[row] -= factor[row, k] * right[k]
        right[row] /= factor[row, row]
    for row in range(size - 1, -1, -1):
        for k in range(row + 1, size):
            right[row] -= factor[k, row] * right[k]
        right[row] /= factor[row, row]


@kernel
def solved_where_independent(matrix: FloatArray, right: FloatArray) -> None:
    """Solve a positive semidefinite system by pivoted Cholesky; what depends on other rows gets 0."""
    size = matrix.shape[0]
    order, largest, rank = np.arange(size), 0.0, 0
    for step in range(size):
        best = step
        for k in range(step + 1, size):
            if matrix[order[k], order[k]] > matrix[order[best], order[best]]:
                best = k
        order[step], order[best] = order[best], order[step]
        here = order[step]
        pivot = matrix[here, here]
        largest = max(largest, pivot)
        if not pivot > _DEPENDENT * largest:
            break
        rank += 1
        root = math.sqrt(pivot)
        matrix[here, here] = root
        for k in range(step + 1, size):
            matrix[order[k], here] /= root
        for k in range(step + 1, size):
            for other in range(step + 1, size):
                matrix[order[k], order[other]] -= matrix[order[k], here] * matrix[order[other], here]
    for step in range(rank):
        here = order[step]
        for k in range(step):
            right[here] -= matrix[here, order[k]] * right[order[k]]
        right[here] /= matrix[here, here]
    for step in range(rank - 1, -1, -1):
        here = order[step]
        for k in range(step + 1, rank):
            right[here] -= matrix[order[k], here] * right[order[k]]
        right[here] /= matrix[here, here]
    for step in range(rank, size):
        right[order[step]] = 0.0
