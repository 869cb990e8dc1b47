"""What joints and carriage of a bench were told, over time."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labrun.devices import FloatArray, Trajectory
from labrun_plugins.simulated.bench.history import packed, unpacked

ACCELERATION_M_S2 = 0.5
"""Ramp length v^2 / 2a: 1 cm at 0.1 m/s. The value is common for a linear move of a UR5 (chosen)."""
ROUNDING_S = 0.05
"""An arm's acceleration does not jump: it takes this long to rise and to fall (chosen)."""


@dataclass
class JointDrive:
    """The commands of one joint: each runs until the next one starts, and holds its last point.

    Attributes
    ----------
    rest_rad
        The angle before any command.
    """

    rest_rad: float = 0.0
    _moves: list[tuple[float, FloatArray, FloatArray]] = field(default_factory=list)

    def command(self, trajectory: Trajectory, start_s: float) -> None:
        """Add a command; it supersedes those that would start at the same time or later."""
        self._moves = [move for move in self._moves if move[0] < start_s]
        self._moves.append((start_s, trajectory.time_s, trajectory.angle_rad[:, 0]))

    def angles(self, time_s: FloatArray) -> FloatArray:
        """Return the commanded angles at ascending times, shape (n,)."""
        angle = np.empty(len(time_s))
        self.write(time_s, angle)
        return angle

    def write(self, time_s: FloatArray, angle_rad: FloatArray) -> None:
        """Write the commanded angles at ascending times, shape (n,)."""
        if self._moves and len(time_s):
            start_s, times, points = self._moves[-1]
            if time_s[0] >= start_s + times[-1]:  # at rest, as nearly always
                angle_rad.fill(points[-1])
                return
        angle_rad.fill(self.rest_rad)
        for start_s, times, points in self._moves:
            first = int(time_s.searchsorted(start_s))
            if first < len(time_s):
                angle_rad[first:] = np.interp(time_s[first:] - start_s, times, points)

    def under_way(self, time_s: FloatArray) -> FloatArray:
        """Return whether a command is under way (1) or has ended (0), at ascending times, shape (n,)."""
        active = np.zeros(len(time_s))
        for start_s, times, _ in self._moves:
            first = int(np.searchsorted(time_s, start_s))
            active[first:] = time_s[first:] <= start_s + times[-1]
        return active

    def forget_before(self, time_s: float) -> None:
        """Drop commands that no longer matter from `time_s` on."""
        started = [index for index, move in enumerate(self._moves) if move[0] <= time_s]
        if not started:
            return
        self._moves = self._moves[started[-1] :]
        start_s, times, points = self._moves[0]
        if start_s + times[-1] < time_s and len(times) > 1:
            # Ended: its last point is all that is left of it. The time is kept, so that "ended" stays true.
            self._moves[0] = (start_s + times[-1], np.zeros(1), points[-1:].copy())
            return
        # Under way: the points already passed but the last are of no more use, and would only swell the snapshot.
        passed = int(np.searchsorted(times, time_s - start_s)) - 2
        if passed > 0:
            self._moves[0] = (start_s, times[passed:], points[passed:])

    def snapshot(self) -> list[Any]:
        """Return the commands as JSON-ready values."""
        return [
            self.rest_rad,
            [[start_s, packed(times), packed(points)] for start_s, times, points in self._moves],
        ]

    def restore(self, stored: list[Any]) -> None:
        """Take back what `snapshot` gave."""
        self.rest_rad = float(stored[0])
        self._moves = [
            (float(start_s), unpacked(times), unpacked(points)) for start_s, times, points in stored[1]
        ]


@dataclass
class Carriage:
    """Where the carriage is, over time: the last move, and where it came from."""

    _from_m: float = 0.0
    _to_m: float = 0.0
    _speed_m_s: float = 0.0
    _start_s: float = 0.0
    _acceleration_m_s2: float = ACCELERATION_M_S2
    _later: list[list[float]] = field(default_factory=list)

    @property
    def at_rest(self) -> bool:
        """Whether it stands still, and no move is to come."""
        return not self._later and (self._to_m == self._from_m or self._speed_m_s <= 0.0)

    @property
    def position_m(self) -> float:
        """Where the last move ends."""
        return self._to_m

    def move(
        self,
        from_m: float,
        to_m: float,
        speed_m_s: float,
        start_s: float,
        acceleration_m_s2: float = ACCELERATION_M_S2,
    ) -> None:
        """Take a move from `start_s` on; it supersedes those that would start later."""
        self._later = [move for move in self._later if move[3] < start_s]
        self._later.append([from_m, to_m, speed_m_s, start_s, acceleration_m_s2])

    def motion(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position (m), speed (m/s), acceleration (m/s^2) at ascending times; forgets moves that are over."""
        if not self._later:
            position, speed, acceleration = self._current(time_s)
            return position, speed, acceleration
        parts = []
        first = 0
        while self._later:
            last = int(np.searchsorted(time_s, self._later[0][3]))
            if last >= len(time_s):
                break
            parts.append(self._current(time_s[first:last]))
            self._begin(self._later.pop(0))
            first = last
        parts.append(self._current(time_s[first:]))
        position, speed, acceleration = np.concatenate(parts, axis=1)
        return position, speed, acceleration

    def _begin(self, move: list[float]) -> None:
        self._from_m, self._to_m, self._speed_m_s, self._start_s, self._acceleration_m_s2 = move

    def _current(self, time_s: FloatArray) -> FloatArray:
        """Return position, speed, acceleration of the current move, shape (3, n): a trapezoid of speed, rounded.

        Rounded by the mean over the last `ROUNDING_S`, so that the acceleration goes straight up and down.
        """
        if self._to_m == self._from_m or self._speed_m_s <= 0.0:
            still = np.zeros((3, len(time_s)))
            still[0] = self._to_m
            return still
        since_s = time_s - self._start_s
        moved = (self._sharp(since_s) - self._sharp(since_s - ROUNDING_S)) / ROUNDING_S
        moved *= math.copysign(1.0, self._to_m - self._from_m)
        moved[0] += self._from_m
        return moved

    def _sharp(self, since_s: FloatArray) -> FloatArray:
        """Return the integral of the way, the way, and the speed of a trapezoid of speed, shape (3, n)."""
        way, ramp = abs(self._to_m - self._from_m), self._acceleration_m_s2
        top = min(self._speed_m_s, math.sqrt(ramp * way))
        ramp_s = top / ramp
        end_s = way / top + ramp_s
        t = np.clip(since_s, 0.0, end_s)
        up, down = np.minimum(t, ramp_s), np.maximum(0.0, t - (end_s - ramp_s))
        even = t - up
        gone = ramp * (0.5 * up**2 + ramp_s * even - 0.5 * down**2)
        summed = ramp * (up**3 / 6.0 + 0.5 * ramp_s * even * (ramp_s + even) - down**3 / 6.0)
        return np.stack([summed + way * np.maximum(since_s - end_s, 0.0), gone, ramp * (up - down)])

    def snapshot(self) -> list[object]:
        """Return the moves as JSON-ready values."""
        return [
            self._from_m,
            self._to_m,
            self._speed_m_s,
            self._start_s,
            self._acceleration_m_s2,
            [list(move) for move in self._later],
        ]

    def restore(self, stored: list[object]) -> None:
        """Take back what `snapshot` gave."""
        self._begin([float(str(one)) for one in stored[:5]])
        later = stored[5]
        self._later = [[float(one) for one in move] for move in later] if isinstance(later, list) else []
