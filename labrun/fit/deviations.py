"""What each trial has of its own beside its initial states: small deviations of known spread."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from labrun.arrays import FloatArray

DeviationKind = Literal["bias", "gain", "start time"]


@dataclass(frozen=True, slots=True)
class Deviation:
    """A deviation that every trial has of its own, normally distributed about zero.

    Attributes
    ----------
    output
        Column of the output that it shows in; None for all, which a start time shifts together.
    sd
        Standard deviation over trials: in the output's unit, of a factor, or in s.
    """

    kind: DeviationKind
    output: int | None
    sd: float


def deviated(
    outputs: FloatArray, time_s: FloatArray, deviations: Sequence[Deviation], own: FloatArray, count: int
) -> FloatArray:
    """Return outputs (n, m) of the mean of `count` trials with their deviations, `own` in standard deviations."""
    found = outputs.copy()
    for one, size in zip(deviations, own * [each.sd / np.sqrt(count) for each in deviations], strict=True):
        columns = slice(None) if one.output is None else slice(one.output, one.output + 1)
        if one.kind == "bias":
            found[:, columns] += size
        elif one.kind == "gain":
            found[:, columns] *= 1.0 + size
        else:
            late = time_s - size
            found[:, columns] = np.column_stack(
                [np.interp(late, time_s, each) for each in found[:, columns].T]
            )
    return found
