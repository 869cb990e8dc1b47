"""How an emulated tool moves: trapezoids of speed along a straight line, and braking."""

import math
from dataclasses import dataclass

import numpy as np

from labrun.devices import FloatArray


@dataclass(frozen=True)
class StraightMove:
    """From one pose to another: up to speed at `acceleration`, cruise, down again; lower where the way is short."""

    from_pose: FloatArray
    to_pose: FloatArray
    speed_m_s: float
    acceleration_m_s2: float

    @property
    def way_m(self) -> float:
        """Length of the way."""
        return float(np.linalg.norm(self.to_pose[:3] - self.from_pose[:3]))

    @property
    def duration_s(self) -> float:
        """Time from rest to rest."""
        top = self._top_m_s()
        return 0.0 if top == 0.0 else self.way_m / top + top / self.acceleration_m_s2

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Return pose and velocity (6 each) this long after the start."""
        top, way = self._top_m_s(), self.way_m
        if top == 0.0 or time_s >= self.duration_s:
            return self.to_pose.copy(), np.zeros(6)
        ramp = top / self.acceleration_m_s2
        left = self.duration_s - time_s
        if time_s < ramp:
            gone, speed = 0.5 * self.acceleration_m_s2 * time_s**2, self.acceleration_m_s2 * time_s
        elif left < ramp:
            gone, speed = way - 0.5 * self.acceleration_m_s2 * left**2, self.acceleration_m_s2 * left
        else:
            gone, speed = top * (time_s - 0.5 * ramp), top
        along = self.to_pose - self.from_pose
        return self.from_pose + along * (gone / way), along * (speed / way)

    def _top_m_s(self) -> float:
        return min(self.speed_m_s, math.sqrt(self.acceleration_m_s2 * self.way_m))


def braking(pose: FloatArray, velocity: FloatArray, deceleration_m_s2: float) -> StraightMove | None:
    """Return the move along which a tool comes to rest; None if it rests already."""
    speed = float(np.linalg.norm(velocity[:3]))
    if speed < 1e-9:
        return None
    way = speed**2 / (2.0 * deceleration_m_s2)
    end = pose + velocity / speed * way
    # The second half of a triangle of speed over twice the way: it begins at full speed, half-way.
    return StraightMove(2.0 * pose - end, end, 2.0 * speed, deceleration_m_s2)


def half_way_s(move: StraightMove) -> float:
    """Return the time at which a braking move begins."""
    return 0.5 * move.duration_s
