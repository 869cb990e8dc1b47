"""Signals read ahead, as a known clock asks for: outputs on their rows, inputs within the steps of the integrator."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect
from labrun.models.model import Model

_ROUNDING, _ROUNDING_S = 1e-9, 1e-10
"""Shares of a signal, and times of its jumps, that are less apart are the same: areas and times are sums of many."""


def read_outputs_ahead(
    model: Model, outputs: FloatArray, steps_s: FloatArray, effects: Sequence[AttachedEffect]
) -> None:
    """Advance an output in time, in place; after the last step it is extrapolated linearly."""
    if not steps_s.size:
        return
    time_s = np.concatenate([[0.0], np.cumsum(steps_s)])
    names = [output.name for output in model.outputs]
    for effect in effects:
        index, lead_s = names.index(effect.site), effect.named_values[effect.effect.ahead]
        course = outputs[:, index].copy()
        slope = (course[-1] - course[-2]) / steps_s[-1]
        beyond_s = np.maximum(time_s + lead_s - time_s[-1], 0.0)
        outputs[:, index] = np.interp(time_s + lead_s, time_s, course) + slope * beyond_s


def inputs_ahead(
    model: Model, u: FloatArray, u_last: FloatArray, steps_s: FloatArray, effects: Sequence[AttachedEffect]
) -> FloatArray:
    """Return inputs (steps, 3, inputs) advanced in time; the last sample is held.

    In steps in which they jump, the middle and the end are moved so that a classical Runge-Kutta step is right to what
    the input makes of rates (its mean, by Simpson's rule) and of coordinates (its first moment): steps need not be so
    short that jumps stand between them.
    """
    if not steps_s.size:
        return u
    u = u.copy()
    names = [signal.name for signal in model.inputs]
    edges_s = np.concatenate([[0.0], np.cumsum(steps_s)])
    for effect in effects:
        index, lead_s = names.index(effect.site), effect.named_values[effect.effect.ahead]
        course = _Pieces(u[:, :, index], float(u_last[index]), steps_s, lead_s)
        begin, until_begin, twice_begin = course.at(edges_s[:-1] + lead_s, "right")
        end, until_end, twice_end = course.at(edges_s[1:] + lead_s, "left")
        middle = course.at(edges_s[:-1] + 0.5 * steps_s + lead_s, "left")[0]
        mean = (until_end - until_begin) / steps_s
        moment = (twice_end - twice_begin - steps_s * until_begin) / steps_s**2
        jumps = course.jumps_within(edges_s[:-1] + lead_s, edges_s[1:] + lead_s)
        middle = np.where(jumps, 3.0 * moment - 0.5 * begin, middle)
        # the integrator takes two steps as one where the signal does not jump between them: to the last bit
        rounding = _ROUNDING * np.max(np.abs(u[:, :, index]))
        end[:-1] = np.where(np.abs(end[:-1] - begin[1:]) > rounding, end[:-1], begin[1:])
        end = np.where(jumps, 6.0 * mean - begin - 4.0 * middle, end)
        u[:, :, index] = np.column_stack([begin, middle, end])
    return u


class _Pieces:
    """A signal of straight pieces, two to each step (steps, 3), which may jump between them; its last value stands."""

    def __init__(self, u: FloatArray, last: float, steps_s: FloatArray, beyond_s: float) -> None:
        self._begin = np.append(u[:, :2].ravel(), last)
        self._end = np.append(u[:, 1:].ravel(), last)
        self._long_s = np.append(np.repeat(0.5 * steps_s, 2), 2.0 * beyond_s + 1.0)
        self._since_s = np.concatenate([[0.0], np.cumsum(self._long_s)[:-1]])
        areas = 0.5 * (self._begin + self._end) * self._long_s
        self._area = np.concatenate([[0.0], np.cumsum(areas)[:-1]])
        twice = (self._area + self._long_s * (self._begin / 3.0 + self._end / 6.0)) * self._long_s
        self._twice = np.concatenate([[0.0], np.cumsum(twice)[:-1]])

    def jumps_within(self, begin_s: FloatArray, end_s: FloatArray) -> NDArray[np.bool_]:
        """Return the jumps between two times."""
        jumps_s = self._since_s[1:][self._begin[1:] != self._end[:-1]]
        before, until = (
            np.searchsorted(jumps_s, time) for time in (begin_s + _ROUNDING_S, end_s - _ROUNDING_S)
        )
        return np.asarray(until > before)

    def at(
        self, time_s: FloatArray, side: Literal["left", "right"]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return value, integral and its integral at some times; of a jump the value before ("left") or after it."""
        near_s = time_s + (_ROUNDING_S if side == "right" else -_ROUNDING_S)
        piece = np.clip(np.searchsorted(self._since_s, near_s, side=side) - 1, 0, len(self._begin) - 1)
        share = (time_s - self._since_s[piece]) / self._long_s[piece]
        rise = self._end[piece] - self._begin[piece]
        value = self._begin[piece] + share * rise
        since_s = share * self._long_s[piece]
        area = (self._begin[piece] + share * rise / 2.0) * since_s
        twice = (self._area[piece] + (self._begin[piece] / 2.0 + share * rise / 6.0) * since_s) * since_s
        return value, self._area[piece] + area, self._twice[piece] + twice
