"""How an emulated tool moves: rounded trapezoids of speed along a straight line, and braking."""

import math
from dataclasses import dataclass

import numpy as np

from labrun.devices import FloatArray

ROUNDING_S = 0.05
"""An arm's acceleration does not jump: it takes this long to rise and to fall (chosen, as the simulated benches do)."""


@dataclass(frozen=True)
class StraightMove:
    """From one pose to another: up to speed at `acceleration`, cruise, down again; lower where the way is short.

    Where it is, is the mean over the last `rounding_s` of where it would be with sharp ramps; 0 leaves them sharp.
    """

    from_pose: FloatArray
    to_pose: FloatArray
    speed_m_s: float
    acceleration_m_s2: float
    rounding_s: float = ROUNDING_S

    @property
    def way_m(self) -> float:
        """Length of the way."""
        return float(np.linalg.norm(self.to_pose[:3] - self.from_pose[:3]))

    @property
    def duration_s(self) -> float:
        """Time from rest to rest."""
        top = self._top_m_s()
        return 0.0 if top == 0.0 else self.way_m / top + top / self.acceleration_m_s2 + self.rounding_s

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Return pose and velocity (6 each) this long after the start."""
        way = self.way_m
        if way == 0.0 or time_s >= self.duration_s:
            return self.to_pose.copy(), np.zeros(6)
        summed, gone, speed = self._sharp(time_s)
        if self.rounding_s > 0.0:
            summed_before, gone_before, _ = self._sharp(time_s - self.rounding_s)
            gone, speed = (summed - summed_before) / self.rounding_s, (gone - gone_before) / self.rounding_s
        along = self.to_pose - self.from_pose
        return self.from_pose + along * (gone / way), along * (speed / way)

    def _sharp(self, time_s: float) -> tuple[float, float, float]:
        """Return the integral of the way over time, the way, and the speed, without rounding."""
        a, top, way = self.acceleration_m_s2, self._top_m_s(), self.way_m
        ramp = top / a
        end = way / top + ramp
        left = end - time_s
        if time_s <= 0.0:
            return 0.0, 0.0, 0.0
        if time_s < ramp:
            return a * time_s**3 / 6.0, 0.5 * a * time_s**2, a * time_s
        if left > ramp:
            cruise = time_s - ramp
            return top * (ramp**2 / 6.0 + 0.5 * cruise * time_s), top * (time_s - 0.5 * ramp), top
        # turned round in time it is the beginning again; half of way times time lies before the middle
        left = max(left, 0.0)
        summed = way * (time_s - 0.5 * end) + a * left**3 / 6.0
        return summed, way - 0.5 * a * left**2, a * left

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
    return StraightMove(2.0 * pose - end, end, 2.0 * speed, deceleration_m_s2, rounding_s=0.0)


def half_way_s(move: StraightMove) -> float:
    """Return the time at which a braking move begins."""
    return 0.5 * move.duration_s
