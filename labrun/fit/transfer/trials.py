"""Input and output of one trial, and what a candidate transfer function answers to it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labrun.fit.signals import trailing_mean
from labrun.fit.transfer.response import Hold, free_answers, powers
from labrun.fit.transfer.shape import Shape

FloatArray = NDArray[np.float64]
SAME_DIRECTION = 1e-6
"""What adds less than this share of the largest direction is rounding: the free answers of poles far apart."""


@dataclass(frozen=True, slots=True)
class ResponseTrial:
    """One trial: evenly spaced input and output.

    Attributes
    ----------
    label
        Names it in figures and messages.
    time_s, given, measured : (n,)
        `given` is the input, `measured` the output.
    used : (n,)
        Which samples the fit is made on.
    averaged
        Samples over which the output was averaged, each with those before it; 1 if it was not.
    hold
        How the input runs between its samples.
    """

    label: str
    time_s: FloatArray
    given: FloatArray
    measured: FloatArray
    used: NDArray[np.bool_]
    averaged: int = 1
    hold: Hold = "linear"

    @property
    def step_s(self) -> float:
        """Time between two samples."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)


@dataclass(slots=True)
class Answers:
    """Answers of one candidate to every input, each computed once however many trials share it."""

    shape: Shape
    moved: FloatArray
    _shared: dict[tuple[int, int], FloatArray] = field(default_factory=dict)
    _own: dict[tuple[int, int], FloatArray] = field(default_factory=dict)

    def shared(self, trial: ResponseTrial) -> FloatArray:
        """Return what the numerator's coefficients (lowest power first) weigh, (n, linear)."""
        key = (id(trial.given), trial.averaged)
        if key not in self._shared:
            denominator, dead_s = self.shape.denominator(self.moved), self.shape.dead_s(self.moved)
            before = float(trial.given[0])
            columns = powers(denominator, dead_s, trial.step_s, trial.given, trial.hold, before)
            columns = columns[:, : self.shape.zeros + 1]
            self._shared[key] = _averaged(columns, trial.averaged)
        return self._shared[key]

    def own(self, trial: ResponseTrial) -> FloatArray:
        """Return what each trial's own numbers weigh: its offset and its initial state, (n, own)."""
        key = (len(trial.time_s), trial.averaged)
        if key not in self._own:
            columns = np.ones((len(trial.time_s), 1))
            if self.shape.initial == "free":
                free = free_answers(self.shape.denominator(self.moved), trial.step_s, len(trial.time_s))
                columns = np.column_stack([columns, _averaged(free, trial.averaged)])
            self._own[key] = columns
        return self._own[key]


def basis(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the columns' span."""
    if columns.shape[1] == 0:
        return columns
    sizes = np.linalg.norm(columns, axis=0)
    u, singular, _ = np.linalg.svd(columns / np.where(sizes > 0, sizes, 1.0), full_matrices=False)
    return np.asarray(u[:, singular > SAME_DIRECTION * singular[0]])


def without(columns: FloatArray, span: FloatArray) -> FloatArray:
    """Return columns less their part in an orthonormal basis."""
    return columns - span @ (span.T @ columns)


def total_s(trials: Sequence[ResponseTrial]) -> float:
    """Return the longest trial's duration."""
    return max(float(trial.time_s[-1] - trial.time_s[0]) for trial in trials)


def _averaged(columns: FloatArray, samples: int) -> FloatArray:
    if samples <= 1:
        return columns
    return np.column_stack([trailing_mean(column, samples) for column in columns.T])
