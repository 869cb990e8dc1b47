"""Between a joint's angle and the counts of its servo."""

import math
from dataclasses import dataclass

from labrun.devices import Limits
from labrun_plugins.dynamixel.control_table import CENTRE, COUNT_RAD, TURNS
from labrun_plugins.dynamixel.settings import DynamixelSettings, Joint

_POSITION_REACH = (0, 4095)
_EXTENDED_REACH = (-TURNS * 4096 + 1, TURNS * 4096 - 1)


@dataclass(frozen=True, slots=True)
class Scale:
    """How one joint's angle is counted.

    Attributes
    ----------
    sign, neutral_rad
        Servo angle = sign * joint angle + neutral; its zero is count 2048.
    reach
        Lowest and highest count of the operating mode.
    bounds
        Lowest and highest count that the limits allow, inside the reach.
    """

    sign: int
    neutral_rad: float
    reach: tuple[int, int]
    bounds: tuple[int, int]

    @classmethod
    def of(cls, joint: Joint, settings: DynamixelSettings) -> "Scale":
        """Return the scale of a joint of these settings."""
        reach = _POSITION_REACH if settings.operating_mode == "position" else _EXTENDED_REACH
        free = cls(int(joint.sign), math.radians(joint.neutral_deg), reach, reach)
        return cls(free.sign, free.neutral_rad, reach, free._bounds(settings.limits))

    def count(self, angle_rad: float) -> int:
        """Return the count nearest to a joint angle, inside the bounds: half a turn is one count beyond the last."""
        low, high = self.bounds
        return min(max(self._count(angle_rad), low), high)

    def angle_rad(self, count: int) -> float:
        """Return the joint angle of a count."""
        return self.sign * ((count - CENTRE) * COUNT_RAD - self.neutral_rad)

    def turns(self, angle_rad: float) -> float:
        """Return how far from its middle a joint angle turns the servo, in turns."""
        return abs(self.sign * angle_rad + self.neutral_rad) / (2.0 * math.pi)

    def inside(self, count: int) -> int:
        """Return the count nearest to this one that the limits allow."""
        low, high = self.bounds
        return min(max(count, low), high)

    def _count(self, angle_rad: float) -> int:
        return CENTRE + round((self.sign * angle_rad + self.neutral_rad) / COUNT_RAD)

    def _bounds(self, limits: Limits) -> tuple[int, int]:
        low, high = self.reach
        if limits.angle_deg is None:
            return self.reach
        ends = sorted(self._exact(math.radians(angle)) for angle in limits.angle_deg)
        # Inwards, so that no whole count lies outside the limit.
        first, last = math.ceil(ends[0] - 1e-6), math.floor(ends[1] + 1e-6)
        return min(max(first, low), high), max(min(last, high), low)

    def _exact(self, angle_rad: float) -> float:
        return CENTRE + (self.sign * angle_rad + self.neutral_rad) / COUNT_RAD
