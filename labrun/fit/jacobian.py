"""Derivatives of residuals by differences, in the block structure that trials give."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray

_STEP = 1e-4
"""Central differences, in units of each variable's scale: error about 1e-8, well below any residual."""


@dataclass(frozen=True)
class Jacobian:
    """Derivatives of the residuals, trial by trial.

    Attributes
    ----------
    shared : per trial (rows, p)
        By the variables that all trials share.
    own : per trial (rows, q)
        By the trial's own free initial states.
    residual : per trial (rows,)
    """

    shared: list[FloatArray]
    own: list[FloatArray]
    residual: list[FloatArray]

    def part(self, chosen: Sequence[int]) -> "Jacobian":
        """Return the derivatives of some of the trials."""
        return Jacobian(*([of[index] for index in chosen] for of in (self.shared, self.own, self.residual)))


def difference_quotient(
    residual: Callable[[float], FloatArray | None],
    centre: float,
    base: FloatArray,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    central: bool = True,
) -> FloatArray:
    """Return the derivative at `centre` by differences, inside bounds.

    To both sides if `central`, else to one; to the other side alone where the simulation is not finite, zero where it
    is so nowhere. `base`: the residual at `centre`.
    """
    before, after = max(centre - _STEP, low), min(centre + _STEP, high)
    ahead = residual(after) if after > centre else None
    if ahead is not None and not central:
        return (ahead - base) / (after - centre)
    behind = residual(before) if before < centre else None
    if ahead is not None and behind is not None:
        return (ahead - behind) / (after - before)
    if ahead is not None:
        return (ahead - base) / (after - centre)
    if behind is not None:
        return (base - behind) / (centre - before)
    return np.zeros_like(base)


def columns(found: Sequence[FloatArray], rows: int) -> FloatArray:
    """Return columns side by side, (rows, 0) if there are none."""
    return np.column_stack(found) if found else np.empty((rows, 0))
