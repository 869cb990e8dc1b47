"""At which torque a beam buckles: from force over displacement of one trial, there and back."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, PositiveFloat

from labrun.devices import FloatArray
from labrun.errors import ExperimentError
from labrun.toml import Keys

_AT_THE_ENDS = 0.03
"""Share of the way, at either end, where the loop between the ways closes."""
_BINS = 200
_SNAP = 0.15
"""A fall of torque by this share of its greatest, with the pusher going on, is a snap."""
_BEFORE = (0.05, 0.25)
"""Share of the angle at the snap between which both ways are on the straight line."""


@dataclass(frozen=True, slots=True)
class BucklingLimit:
    """What one trial says of a beam.

    Attributes
    ----------
    sense
        "opposite" where the pusher went the positive way.
    torque_n_m
        At which it buckles; without the loop, which adds to it on the way there. Positive in both senses.
    reached
        Whether it buckled; if not, `torque_n_m` is the greatest that it bore.
    """

    sense: Literal["equal", "opposite"]
    torque_n_m: float
    reached: bool


def buckling_limit(force_n: FloatArray, displacement_m: FloatArray, lever_m: float) -> BucklingLimit:
    """Find the torque at which a beam buckles.

    In equal sense the torque goes on growing, slowly: the limit is the knee of two straight lines through the mean of
    both ways. In opposite sense it falls: the limit is the greatest torque, less half the loop.

    Parameters
    ----------
    force_n, displacement_m : (n,)
        One way there and back, tared.

    Raises
    ------
    ExperimentError
        The pusher did not go there and back.
    """
    turn = int(np.argmax(np.abs(displacement_m)))
    opposite = displacement_m[turn] > 0
    sign = 1.0 if opposite else -1.0
    angle, torque = sign * displacement_m / lever_m, sign * lever_m * force_n
    way = float(angle[turn])
    if not way > 0 or turn < _BINS // 4 or len(angle) - turn < _BINS // 4 or angle[-1] > 0.1 * way:
        raise ExperimentError(
            f"the pusher did not go there and back: it ends {1e3 * displacement_m[-1]:.3g} mm from where it began, "
            f"after {1e3 * displacement_m[turn]:.3g} mm",
            hint="a buckling test is one whole cycle of a ramp or staircase",
        )
    if opposite:
        return _snap(angle, torque, turn)
    at = np.linspace(_AT_THE_ENDS * way, (1.0 - _AT_THE_ENDS) * way, _BINS)
    mean = 0.5 * (_at(angle[: turn + 1], torque[: turn + 1], at) + _at(angle[turn:], torque[turn:], at))
    return _knee(at, mean)


def _at(angle: FloatArray, torque: FloatArray, at: FloatArray) -> FloatArray:
    """Return the torque at these angles: the mean of the samples next to each."""
    width = at[1] - at[0]
    bins = np.round((angle - at[0]) / width).astype(int)
    inside = (bins >= 0) & (bins < len(at))
    counts = np.bincount(bins[inside], minlength=len(at))
    sums = np.bincount(bins[inside], weights=torque[inside], minlength=len(at))
    known = counts > 0
    return np.interp(at, at[known], sums[known] / counts[known])


def _knee(angle: FloatArray, torque: FloatArray) -> BucklingLimit:
    """Fit offset + stiffness * angle up to the knee and a softer line beyond; least squares over the knee's place."""

    def left_over(knee: float) -> tuple[float, FloatArray]:
        matrix = np.column_stack(
            [np.ones_like(angle), np.minimum(angle, knee), np.maximum(angle - knee, 0.0)]
        )
        coefficients = np.linalg.lstsq(matrix, torque, rcond=None)[0]
        return float(np.sum(np.square(torque - matrix @ coefficients))), coefficients

    from scipy.optimize import minimize_scalar

    places = angle[2:-2]
    best = int(np.argmin([left_over(float(position))[0] for position in places]))
    low, high = float(places[max(best - 1, 0)]), float(places[min(best + 1, len(places) - 1)])
    knee = float(minimize_scalar(lambda bound: left_over(float(bound))[0], bounds=(low, high)).x)
    _, stiffness, soft = left_over(knee)[1]
    reached = bool(soft < 0.5 * stiffness and knee < 0.95 * angle[-1])
    return BucklingLimit("equal", float(stiffness * knee) if reached else float(torque.max()), reached)


def _snap(angle: FloatArray, torque: FloatArray, turn: int) -> BucklingLimit:
    there = torque[: turn + 1]
    top = int(np.argmax(there))
    peak, peak_angle = float(there[top]), float(angle[top])
    reached = bool(np.min(there[top:]) < (1.0 - _SNAP) * peak)
    at = np.linspace(_BEFORE[0] * peak_angle, _BEFORE[1] * peak_angle, _BINS)
    half = 0.5 * (_at(angle[: turn + 1], there, at) - _at(angle[turn:], torque[turn:], at))
    return BucklingLimit("opposite", peak - max(float(np.median(half)), 0.0), reached)


class BucklingLimitSettings(Keys):
    """Keys of the objective: the channel of the displacement, m, and the lever that makes it an angle."""

    over: str
    lever_mm: PositiveFloat = 100.0


class BucklingLimitObjective:
    """Torque at which the beam buckles in the sense it was bent in, N m; the greatest it bore where it did not."""

    Settings: ClassVar[type[BaseModel]] = BucklingLimitSettings
    needs_channel: ClassVar[bool] = True
    channel_settings: ClassVar[tuple[str, ...]] = ("over",)

    def __init__(self, channel: str | None, settings: Mapping[str, Any]) -> None:
        self.channel = channel or ""
        keys = BucklingLimitSettings.model_validate(dict(settings))
        self.over, self._lever_m = keys.over, 1e-3 * keys.lever_mm

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return "N m"."""
        return "N m"

    def __call__(self, signals: Any) -> float:
        """Return the torque."""
        force, way = signals.signal(self.channel), signals.signal(self.over)
        force = force.between(signals.start_s, signals.end_s)
        at = np.interp(force.time_s, way.time_s, way.values)
        return buckling_limit(force.values, at, self._lever_m).torque_n_m
