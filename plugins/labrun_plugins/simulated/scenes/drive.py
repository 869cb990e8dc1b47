"""What a joint was told, over time."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labrun.devices import FloatArray, Trajectory
from labrun_plugins.simulated.scenes.memory import packed, unpacked


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
