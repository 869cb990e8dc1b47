"""Repeats that no single simulation predicts, averaged by what the model leaves of each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.dataset import Dataset, FitTrial


@dataclass(frozen=True)
class Piece:
    """All data of one condition, on the time base of its first unit.

    Attributes
    ----------
    group
        Number of the condition.
    members
        Dataset that are averaged in it.
    shares
        Their weights, by the number of trials behind each; they add up to 1.
    trial
        The first of them.
    length
        Samples that all of them have.
    """

    group: int
    members: tuple[int, ...]
    shares: FloatArray
    trial: FitTrial
    length: int

    @property
    def time_s(self) -> FloatArray:
        """Time base, shape (length,)."""
        return self.trial.time_s[: self.length]

    def of(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the weighted mean of arrays (n, ...) of every unit, over this piece's units."""
        if len(self.members) == 1:
            return values[self.members[0]][: self.length]
        stacked = np.stack([values[index][: self.length] for index in self.members])
        mean: FloatArray = np.tensordot(self.shares, stacked, axes=1)
        return mean

    def first(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the array of its first unit, cut to this piece's length."""
        return values[self.members[0]][: self.length]


def pieces(units: Dataset) -> tuple[Piece, ...]:
    """Return one piece per condition; units of a condition with another time step stay apart."""
    found: list[Piece] = []
    for group in range(len(units.conditions)):
        alike: dict[float, list[int]] = {}
        for index in units.of_group(group):
            time_s = units.trials[index].time_s
            step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
            near = next((known for known in alike if abs(known - step) <= 0.01 * known), step)
            alike.setdefault(near, []).append(index)
        for members in alike.values():
            counts = np.array([units.trials[index].count for index in members], dtype=float)
            length = min(len(units.trials[index].time_s) for index in members)
            trial = units.trials[members[0]]
            found.append(Piece(group, tuple(members), counts / counts.sum(), trial, length))
    return tuple(found)
