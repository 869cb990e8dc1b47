"""The command of a steered gait, piece by piece, and what was really sent of it."""

import math
from collections.abc import Mapping

import numpy as np

from labrun.devices import FloatArray, Trajectory
from labrun.gaits import Steering

_SAME_S = 1e-6
"""Two points of a command are further apart than this."""


class Pieces:
    """Cuts a steered gait into pieces, one a step of the loop.

    Within a step's period the steered variables go straight from where they stand to where the step sets them. A piece
    is twice as long as a period: for the second half the gait goes on with its variables held, so that one step that
    comes late goes unnoticed; after that the actuator stands still at the piece's last point, which is the safe state
    of every actuator. When the next command comes at last, the gait goes on from where it stopped: the angles that are
    commanded never jump.

    Parameters
    ----------
    steering
        Of the gait.
    start
        Values of the steered variables at the beginning.
    slew_per_s
        How fast each may change; those that are not named may go anywhere within a period.
    rate_hz
        Points of a piece come no less often.
    duration_s
        Of the recording: no piece goes on after it.
    cycle_s
        Of the gait.
    """

    def __init__(
        self,
        steering: Steering,
        joints: tuple[str, ...],
        start: Mapping[str, float],
        *,
        slew_per_s: Mapping[str, float],
        period_s: float,
        rate_hz: float,
        duration_s: float,
        cycle_s: float | None,
    ) -> None:
        self._steering = steering
        self._joints = joints
        self._period_s = period_s
        self._rate_hz = rate_hz
        self._duration_s = duration_s
        self._cycle_s = cycle_s
        self._most = {name: rate * period_s for name, rate in slew_per_s.items()}
        self._from = dict(start)
        self._to = dict(start)
        self._gait_s = 0.0
        self._start_s = 0.0
        self._grid = self._points(2.0 * period_s)
        self._ramp = np.minimum(self._grid / period_s, 1.0)
        self._sent: list[tuple[float, FloatArray, FloatArray]] = []
        self._made: tuple[float, FloatArray, FloatArray] | None = None

    def first(self) -> Trajectory:
        """Return the first piece, from time 0."""
        return self._piece(None)

    def drives(self, time_s: float) -> dict[str, float]:
        """Return where the steered variables stand at a time of the trial."""
        share = min(max((time_s - self._start_s) / self._period_s, 0.0), 1.0)
        return {name: value + share * (self._to[name] - value) for name, value in self._from.items()}

    def next(self, time_s: float, goals: Mapping[str, float]) -> Trajectory:
        """Return the piece that begins at a time of the trial and takes the variables towards their goals."""
        before_s, times, angles = self._sent[-1]
        passed_s = time_s - before_s
        here = np.array([np.interp(passed_s, times, column) for column in angles.T])
        self._from = self.drives(time_s)
        self._to = {name: self._within_slew(name, goals[name]) for name in self._from}
        self._gait_s += min(passed_s, float(times[-1]))
        self._start_s = time_s
        return self._piece(here)

    @property
    def goals(self) -> Mapping[str, float]:
        """Values that the variables reach one period after the start of the latest piece."""
        return self._to

    def _within_slew(self, name: str, goal: float) -> float:
        """Bound a goal by the slew rate from where the variable stands now, later than when the step began."""
        most = self._most.get(name, math.inf)
        return min(max(goal, self._from[name] - most), self._from[name] + most)

    def sent(self) -> None:
        """Take note that the latest piece has gone out: a piece that is refused is none that was commanded."""
        if self._made is not None:
            self._sent.append(self._made)
            self._made = None

    def command(self) -> Trajectory | None:
        """Return everything that was sent, each piece until the next one took its place; None if nothing was."""
        if not self._sent:
            return None
        ends = [start_s for start_s, _, _ in self._sent[1:]]
        parts = []
        for (start_s, times, angles), end_s in zip(self._sent, [*ends, math.inf], strict=True):
            kept = times < end_s - start_s - _SAME_S
            parts.append((start_s + times[kept], angles[kept]))
        time_s, angle_rad = (np.concatenate(column) for column in zip(*parts, strict=True))
        return Trajectory(self._joints, time_s, angle_rad, self._cycle_s)

    def _piece(self, here: FloatArray | None) -> Trajectory:
        left_s = self._duration_s - self._start_s
        grid, ramp = self._grid, self._ramp
        if left_s < grid[-1]:
            grid = self._points(max(left_s, 10 * _SAME_S))
            ramp = np.minimum(grid / self._period_s, 1.0)
        values = {name: value + ramp * (self._to[name] - value) for name, value in self._from.items()}
        angle_rad = self._steering(self._gait_s + grid, values)
        if here is not None:
            angle_rad[0] = here
        self._made = (self._start_s, grid, angle_rad)
        return Trajectory(self._joints, grid, angle_rad, self._cycle_s)

    def _points(self, length_s: float) -> FloatArray:
        steps = max(1, math.ceil(length_s * self._rate_hz * (1 - 1e-9)))
        return np.linspace(0.0, length_s, steps + 1)
