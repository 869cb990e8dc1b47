"""The carriage: straight moves at constant speed, with a ramp at either end."""

import math
from dataclasses import dataclass, field

import numpy as np

from labrun.devices import FloatArray

ACCELERATION_M_S2 = 0.5
"""Ramp length v^2 / 2a: 1 cm at 0.1 m/s. The value is common for a linear move of a UR5 (chosen)."""


@dataclass
class Carriage:
    """Where the carriage is, over time: the last move, and where it came from."""

    _from_m: float = 0.0
    _to_m: float = 0.0
    _speed_m_s: float = 0.0
    _start_s: float = 0.0
    _later: list[list[float]] = field(default_factory=list)

    @property
    def at_rest(self) -> bool:
        """Whether it stands still, and no move is to come."""
        return not self._later and (self._to_m == self._from_m or self._speed_m_s <= 0.0)

    @property
    def position_m(self) -> float:
        """Where the last move ends."""
        return self._to_m

    def move(self, from_m: float, to_m: float, speed_m_s: float, start_s: float) -> None:
        """Take a move from `start_s` on; it supersedes those that would start later."""
        self._later = [move for move in self._later if move[3] < start_s]
        self._later.append([from_m, to_m, speed_m_s, start_s])

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
            self._from_m, self._to_m, self._speed_m_s, self._start_s = self._later.pop(0)
            first = last
        parts.append(self._current(time_s[first:]))
        position, speed, acceleration = np.concatenate(parts, axis=1)
        return position, speed, acceleration

    def _current(self, time_s: FloatArray) -> FloatArray:
        """Return position, speed, acceleration of the current move, shape (3, n): a trapezoid of speed."""
        way = abs(self._to_m - self._from_m)
        if way == 0.0 or self._speed_m_s <= 0.0:
            still = np.zeros((3, len(time_s)))
            still[0] = self._to_m
            return still
        top = min(self._speed_m_s, math.sqrt(ACCELERATION_M_S2 * way))
        ramp_s = top / ACCELERATION_M_S2
        end_s = way / top + ramp_s
        t = np.clip(time_s - self._start_s, 0.0, end_s)
        up, down = np.minimum(t, ramp_s), np.maximum(0.0, t - (end_s - ramp_s))
        speed = ACCELERATION_M_S2 * (up - down)
        position = ACCELERATION_M_S2 * (0.5 * up**2 + ramp_s * (t - up) - 0.5 * down**2)
        moving = (time_s > self._start_s) & (time_s < self._start_s + end_s)
        acceleration = ACCELERATION_M_S2 * moving * ((t < ramp_s) * 1.0 - (t > end_s - ramp_s))
        sign = math.copysign(1.0, self._to_m - self._from_m)
        return np.stack([self._from_m + sign * position, sign * speed, sign * acceleration])

    def snapshot(self) -> list[object]:
        """Return the moves as JSON-ready values."""
        return [
            self._from_m,
            self._to_m,
            self._speed_m_s,
            self._start_s,
            [list(move) for move in self._later],
        ]

    def restore(self, stored: list[object]) -> None:
        """Take back what `snapshot` gave."""
        self._from_m, self._to_m, self._speed_m_s, self._start_s = (float(str(one)) for one in stored[:4])
        later = stored[4]
        self._later = [[float(one) for one in move] for move in later] if isinstance(later, list) else []
