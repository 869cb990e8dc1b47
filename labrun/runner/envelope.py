"""The worst that a steered gait can do: every value a loop may give to its variables, as fast as it may."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from labrun.devices import Excess, FloatArray, Limits
from labrun.gaits import Gait, Steering, steering_of
from labrun.spec import Condition, Track

_VALUES = 5
"""Values of each variable that are looked at, the bounds of its range among them."""
_POINTS = 720
"""Moments of a gait cycle that are looked at, at least."""
_STEP_S = 1e-4
"""Half the time over which a speed is taken."""
_STEP_SHARE = 1e-5
"""Share of a variable's range over which its effect on a joint is taken."""
_TOLERANCE = 1e-6
"""Relative, of the differences that stand for derivatives."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """Bounds of what joints may be commanded while loops steer them.

    Attributes
    ----------
    joints
        Their names; all arrays are of shape (joints,).
    speed_deg_s
        Greatest speed: of the gait itself at any value of the variables, and on top of it what their own greatest
        change adds at that moment.
    """

    joints: tuple[str, ...]
    low_deg: FloatArray
    high_deg: FloatArray
    speed_deg_s: FloatArray

    def excess(self, joints: tuple[str, ...], limits: Limits) -> list[Excess]:
        """Return what of a device's limits these joints may leave."""
        found = []
        for joint in joints:
            number = self.joints.index(joint)
            if limits.angle_deg is not None:
                for value, bound, beyond in (
                    (self.low_deg[number], limits.angle_deg[0], self.low_deg[number] < limits.angle_deg[0]),
                    (self.high_deg[number], limits.angle_deg[1], self.high_deg[number] > limits.angle_deg[1]),
                ):
                    if beyond and abs(value - bound) > _TOLERANCE * max(1.0, abs(bound)):
                        found.append(Excess(f"worst angle of {joint}", float(value), bound, "deg", 0.0))
            most = limits.speed_deg_s
            speed = float(self.speed_deg_s[number])
            if most is not None and speed > most * (1 + _TOLERANCE):
                found.append(Excess(f"worst speed of {joint}", speed, most, "deg/s", 0.0))
        return found


def envelope(
    track: Track, gait: Gait, plugin: str, condition: Condition, *, duration_s: float, rate_hz: float
) -> Envelope:
    """Return the worst case of a steered gait under a condition.

    Looked at are the bounds of every variable's range and values between them, in all combinations, over one cycle of
    the gait (over the whole motion, if it does not repeat or its formulas hold the time). For angles that are linear in
    the variables, as offset and amplitude are, the bounds are the worst there is.

    Parameters
    ----------
    track
        Ranges and slew rates. Without a slew rate a variable may cross its range within one step.
    gait, plugin
        The gait, and its name in the file.
    duration_s, rate_hz
        Of the motion and its points.

    Raises
    ------
    SpecError
        The gait cannot be steered.
    """
    steered = track.steered
    drives = list(steered)
    ranges = {name: (float(table.range[0]), float(table.range[1])) for name, table in steered.items()}
    rates = {
        name: table.slew_per_s or (ranges[name][1] - ranges[name][0]) * track.rate_hz
        for name, table in steered.items()
    }
    steering = steering_of(gait, plugin, condition, drives)
    start = {name: table.start for name, table in steered.items()}
    time_s = _moments(gait, {**condition, **start}, duration_s, rate_hz)
    low, high, speed = (np.full(len(gait.joints), value) for value in (np.inf, -np.inf, 0.0))
    axes = [np.linspace(bounds[0], bounds[1], _VALUES) for bounds in ranges.values()]
    for point in itertools.product(*axes):
        values = dict(zip(drives, map(float, point), strict=True))
        angle = _at(steering, time_s, values)
        low, high = np.minimum(low, angle.min(axis=0)), np.maximum(high, angle.max(axis=0))
        fastest = np.abs(
            _at(steering, time_s + _STEP_S, values) - _at(steering, time_s - _STEP_S, values)
        ) / (2 * _STEP_S)
        for name in drives:
            step = _STEP_SHARE * (ranges[name][1] - ranges[name][0])
            moved = _at(steering, time_s, {**values, name: values[name] + step})
            fastest = fastest + rates[name] * np.abs(moved - angle) / step
        speed = np.maximum(speed, fastest.max(axis=0))
    return Envelope(gait.joints, np.degrees(low), np.degrees(high), np.degrees(speed))


def loop_notes(track: Track | None) -> Iterator[str]:
    """Yield what each loop may do, beside which the worst case is read."""
    if track is None:
        return
    for name, loop in track.loops.items():
        low, high = loop.range
        slew = "anywhere in a step" if loop.slew_per_s is None else f"by at most {loop.slew_per_s:g}/s"
        yield (
            f"loop {name} sets {' and '.join(loop.drives)} to {low:g} ... {high:g} {track.rate_hz:g} times a second, "
            f"{slew}; joints are shown at the worst that the loops may ask for"
        )


def _at(steering: Steering, time_s: FloatArray, values: Mapping[str, float]) -> FloatArray:
    return steering(time_s, {name: np.full(len(time_s), value) for name, value in values.items()})


def _moments(gait: Gait, condition: Condition, duration_s: float, rate_hz: float) -> FloatArray:
    """Return the times to look at: a cycle of a gait that is the same in each, else the whole motion."""
    period_s = gait.period_s(condition)
    by_formula = "t" in getattr(gait, "names", ())
    span_s = duration_s if period_s is None or by_formula else min(period_s, duration_s)
    return np.linspace(0.0, span_s, max(_POINTS, int(span_s * rate_hz)) + 1)
