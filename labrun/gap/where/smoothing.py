"""Penalised least squares in blocks, the penalty chosen by generalised cross-validation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_RIDGE = 1e-6
"""Beside the roughness: keeps a constant nobody sees from growing without bound."""
_PENALTIES = 50


@dataclass(frozen=True)
class Smooth:
    """Coefficients of every block, and what they leave.

    Attributes
    ----------
    coefficients : per block (k,)
    expected
        Sum of squares that white noise of variance 1 would leave of itself.
    """

    coefficients: list[FloatArray]
    expected: float


def smooth(blocks: Sequence[FloatArray], values: FloatArray, span: FloatArray) -> Smooth:
    """Fit every block's rows by its own columns, with smooth coefficients, beside a span that is free.

    Minimises ``|v - H c|^2 + penalty |second differences of c|^2`` after projecting `span` out of both sides
    (B-splines with a difference penalty: Eilers and Marx 1996), the penalty, one for all, by generalised
    cross-validation (Craven and Wahba 1979).

    Parameters
    ----------
    blocks : per unit (rows, k)
    values : (all rows,)
    span : (all rows, p)
        Orthonormal columns.
    """
    from scipy.linalg import block_diag, eigh

    ends = np.cumsum([len(block) for block in blocks])[:-1]
    left = values - span @ (span.T @ values)
    spanned = np.concatenate(
        [part.T @ block for part, block in zip(np.split(span, ends), blocks, strict=True)], axis=1
    )
    gram = block_diag(*[block.T @ block for block in blocks]) - spanned.T @ spanned
    right = np.concatenate([block.T @ part for block, part in zip(blocks, np.split(left, ends), strict=True)])
    rough = block_diag(*[_roughness(block.shape[1]) for block in blocks])
    size, vectors = eigh(gram, rough)
    size = np.maximum(size, 0.0)
    seen = vectors.T @ right
    free = len(values) - span.shape[1]
    whole = float(left @ left)
    best, chosen = np.inf, float(size.max()) + 1e-300
    for penalty in float(size.max()) * np.geomspace(1e-12, 10.0, _PENALTIES) + 1e-300:
        shrunk = 1.0 / (size + penalty)
        rest = whole - float(np.sum(seen**2 * (2.0 * shrunk - size * shrunk**2)))
        used = float(np.sum(size * shrunk))
        score = rest / max(free - used, 1.0) ** 2
        if score < best:
            best, chosen = score, float(penalty)
    kept = size / (size + chosen)
    expected = free - float(np.sum(2.0 * kept - kept**2))
    coefficients = vectors @ (seen / (size + chosen))
    return Smooth(np.split(coefficients, np.cumsum([block.shape[1] for block in blocks])[:-1]), expected)


def _roughness(count: int) -> FloatArray:
    differences = np.diff(np.eye(count), n=2, axis=0)
    return np.asarray(differences.T @ differences + _RIDGE * np.eye(count), dtype=float)
