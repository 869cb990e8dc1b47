"""The systematic part of a residual: its mean square over a condition's repeats, less what noise leaves in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.dataset import Dataset
from labrun.fit.problem import Problem
from labrun.gap.noise import Noise


@dataclass(frozen=True)
class Excess:
    """Excess of the squared mean residual over the noise floor, condition by condition.

    Attributes
    ----------
    values : (groups, m)
        Mean over a condition's samples, in units of the variance of one trial's noise. May be slightly negative.
    weights : (groups,)
        Share of the samples.
    """

    values: FloatArray
    weights: FloatArray

    @property
    def total(self) -> float:
        """Mean over channels and samples."""
        return float(self.weights @ np.mean(self.values, axis=1))

    @property
    def gap(self) -> float:
        """Root mean square of the systematic residual over channels, in units of one trial's noise."""
        return float(np.sqrt(max(self.total, 0.0)))


def mean_residuals(problem: Problem, z: FloatArray) -> list[FloatArray]:
    """Return measured mean minus simulated of every unit, (n, m) each, in the units of the outputs."""
    return [
        trial.outputs - outputs
        for trial, outputs in zip(problem.data.trials, problem.simulated(z), strict=True)
    ]


def group_means(units: Dataset, residual: Sequence[FloatArray]) -> list[tuple[FloatArray, int]]:
    """Return the mean residual of every condition and the number of trials behind it."""
    found = []
    for group in range(len(units.conditions)):
        members = units.of_group(group)
        if not members:
            continue
        counts = np.array([units.trials[index].count for index in members], dtype=float)
        length = min(len(residual[index]) for index in members)
        stacked = np.stack([residual[index][:length] for index in members])
        found.append((np.tensordot(counts / counts.sum(), stacked, axes=1), int(counts.sum())))
    return found


def excess(units: Dataset, noise: Noise, residual: Sequence[FloatArray]) -> Excess:
    """Return the excess of mean residuals (one array per unit) over the noise floor."""
    groups = group_means(units, residual)
    present = [group for group in range(len(units.conditions)) if units.of_group(group)]
    values = []
    for group, (mean, count) in zip(present, groups, strict=True):
        values.append(np.mean(np.square(mean / noise.sd), axis=0) - noise.mean_floor(group, count))
    sizes = np.array([float(len(mean)) for mean, _ in groups])
    return Excess(np.array(values), sizes / sizes.sum())
