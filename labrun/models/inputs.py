"""What drives a simulation between the samples of its inputs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import ModelError
from labrun.models.model import Between

_REACH = 64
"""Samples on each side that a band-limited value is made from: flat up to 96 % of the Nyquist frequency."""
_KAISER_BETA = 8.0
"""Window of the sinc: 80 dB stop band (Kaiser 1974)."""
_UNEVEN = 0.02
"""Relative spread of sample intervals up to which a signal counts as evenly sampled (rounded or jittered stamps)."""


@dataclass(frozen=True)
class Drive:
    """Inputs on the integrator's steps.

    Attributes
    ----------
    time_s : (samples,)
    steps_s : (steps,)
        Length of each step.
    u : (steps, 3, inputs)
        At start, middle and end of each step; the end of one and the start of the next differ where an input jumps.
    u_last : (inputs,)
        At the last sample.
    substeps
        Steps in each interval between samples.
    """

    time_s: FloatArray
    steps_s: FloatArray
    u: FloatArray
    u_last: FloatArray
    substeps: int

    @property
    def first(self) -> FloatArray:
        """Inputs at the first sample, shape (inputs,)."""
        first: FloatArray = self.u[0, 0] if len(self.u) else self.u_last
        return first


def drive(time_s: FloatArray, inputs: FloatArray, between: Sequence[Between], substeps: int) -> Drive:
    """Lay the inputs of one trial on the integrator's steps.

    Parameters
    ----------
    time_s : (samples,)
        Strictly increasing, s.
    inputs : (samples, inputs)
    between
        How each input runs between its samples.

    Raises
    ------
    ModelError
        Shapes that do not match, times that do not increase, values that are not finite, a band-limited input that is
        not evenly sampled.
    """
    time_s = np.ascontiguousarray(time_s, dtype=float)
    values = np.ascontiguousarray(inputs, dtype=float)
    if values.ndim == 1 and len(between) == 1:
        values = values[:, None]
    if values.size == 0 and not between:
        values = np.empty((len(time_s), 0))
    _check(time_s, values, len(between), substeps)
    intervals = time_s[1:] - time_s[:-1]
    _check_times(time_s, intervals)
    steps_s = np.repeat(intervals / substeps, substeps) if substeps > 1 else intervals
    u = np.empty((len(intervals), substeps, 3, len(between)))
    for index, kind in enumerate(between):
        column = values[:, index]
        if kind == "hold":
            u[..., index] = column[:-1, None, None]
            continue
        fractions = np.arange(2 * substeps + 1) / (2 * substeps)
        grid = (
            column[:-1, None] * (1 - fractions) + column[1:, None] * fractions
            if kind == "linear"
            else _band_limited(time_s, column, fractions)
        )
        for place in range(3):
            u[:, :, place, index] = grid[:, place : 2 * substeps - 1 + place : 2]
    return Drive(time_s, steps_s, u.reshape(len(steps_s), 3, len(between)), values[-1].copy(), substeps)


def _check(time_s: FloatArray, values: FloatArray, inputs: int, substeps: int) -> None:
    if time_s.ndim != 1 or len(time_s) < 1:
        raise ModelError(f"a simulation needs at least one time; time_s has shape {time_s.shape}")
    if values.shape != (len(time_s), inputs):
        raise ModelError(
            f"{inputs} inputs at {len(time_s)} times were expected; the values have shape {values.shape}"
        )
    if substeps < 1:
        raise ModelError(f"substeps must be 1 or more, not {substeps}")
    if values.size and not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise ModelError(f"input {column} is not finite at sample {row} (t = {time_s[row]:g} s)")


def _check_times(time_s: FloatArray, intervals: FloatArray) -> None:
    # not-a-number compares false, and infinite times have an infinite interval or none
    if intervals.size and intervals.min() > 0 and np.isfinite(intervals.max()) and np.isfinite(time_s[0]):
        return
    if not np.isfinite(time_s).all() or intervals.size:
        worst = int(np.argmin(intervals)) if intervals.size else 0
        raise ModelError(f"time_s must increase; at sample {worst + 1} it does not")


def _band_limited(time_s: FloatArray, values: FloatArray, fractions: FloatArray) -> FloatArray:
    """Resample by a windowed sinc, shape (intervals, fractions).

    Beyond its ends the signal is continued by point reflection, which keeps value and slope; what a record's first and
    last `_REACH` samples contain near the Nyquist frequency is therefore a guess. A constant stays exactly constant.
    """
    if len(values) < 3:
        return np.asarray(values[:-1, None] * (1 - fractions) + values[1:, None] * fractions)
    intervals = np.diff(time_s)
    spread = np.max(np.abs(intervals - intervals.mean())) / intervals.mean()
    if spread > _UNEVEN:
        worst = int(np.argmax(np.abs(intervals - intervals.mean())))
        raise ModelError(
            f"a band-limited input must be sampled evenly; the interval at t = {time_s[worst]:g} s "
            f"differs by {spread:.0%} from the mean",
            hint='resample the recording, or declare the input between = "linear"',
        )
    padded = np.pad(values, _REACH, mode="reflect", reflect_type="odd")
    taps = np.arange(-_REACH + 1, _REACH + 1)
    result = np.empty((len(intervals), len(fractions)))
    for index, fraction in enumerate(fractions):
        offset = taps - fraction
        window = np.i0(_KAISER_BETA * np.sqrt(np.clip(1 - (offset / _REACH) ** 2, 0, 1)))
        weights = np.sinc(offset) * window
        weights /= weights.sum()
        result[:, index] = np.correlate(padded[1:], weights, mode="valid")[: len(intervals)]
    return result
