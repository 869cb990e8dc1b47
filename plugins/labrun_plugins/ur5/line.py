"""The straight line along which the tool is carried."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from labrun.devices import FloatArray

Pose = tuple[float, float, float, float, float, float]
"""Tool pose in the base frame: x, y, z (m) and rotation vector (rad)."""


@dataclass(frozen=True)
class Line:
    """Positions along a line in the base frame, at one orientation.

    Attributes
    ----------
    origin_m : (3,)
        Position zero.
    direction : (3,)
        Unit vector of rising position.
    orientation_rad : (3,)
        Rotation vector that the tool keeps.
    """

    origin_m: FloatArray
    direction: FloatArray
    orientation_rad: FloatArray

    @classmethod
    def through(
        cls,
        pose: ArrayLike,
        direction: ArrayLike,
        origin_m: ArrayLike | None = None,
        orientation_rad: ArrayLike | None = None,
    ) -> "Line":
        """Return the line through `origin_m`, at `orientation_rad`; what is not given is taken from `pose`."""
        here = np.asarray(pose, dtype=float)
        along = np.asarray(direction, dtype=float)
        return cls(
            here[:3].copy() if origin_m is None else np.asarray(origin_m, dtype=float),
            along / np.linalg.norm(along),
            here[3:].copy() if orientation_rad is None else np.asarray(orientation_rad, dtype=float),
        )

    def position_m(self, pose: FloatArray) -> FloatArray:
        """Return how far along the line tool poses (..., 6) are."""
        return np.asarray((pose[..., :3] - self.origin_m) @ self.direction)

    def speed_m_s(self, twist: FloatArray) -> FloatArray:
        """Return the speed along the line of tool velocities (..., 6)."""
        return np.asarray(twist[..., :3] @ self.direction)

    def pose(self, position_m: float) -> Pose:
        """Return the tool pose at a position."""
        point = self.origin_m + position_m * self.direction
        x, y, z, rx, ry, rz = (float(one) for one in (*point, *self.orientation_rad))
        return x, y, z, rx, ry, rz

    def beside_m(self, pose: FloatArray) -> float:
        """Return the distance of a tool pose from the line."""
        away = pose[:3] - self.origin_m
        return float(np.linalg.norm(away - (away @ self.direction) * self.direction))

    def turned_rad(self, pose: FloatArray) -> float:
        """Return the angle between a tool pose's orientation and the line's."""
        cosine = abs(float(quaternion(pose[3:]) @ quaternion(self.orientation_rad)))
        return 2.0 * math.acos(min(1.0, cosine))


def quaternion(rotation_rad: FloatArray) -> FloatArray:
    """Return the unit quaternion (w, x, y, z) of a rotation vector."""
    angle = float(np.linalg.norm(rotation_rad))
    # sin(a/2)/a tends to 1/2, where the division would fail.
    share = 0.5 if angle < 1e-9 else math.sin(angle / 2.0) / angle
    return np.array([math.cos(angle / 2.0), *(share * np.asarray(rotation_rad, dtype=float))])
