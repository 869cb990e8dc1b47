"""What an orientation is in angles, by the conventions of the channels."""

import math

import numpy as np

from labrun.devices import FloatArray


def angles(quaternion: FloatArray) -> tuple[float, float, float]:
    """Return heading (0 ... 2 pi), roll (+-pi/2) and pitch (+-pi), rad, of a quaternion w, x, y, z of length 1.

    Heading is a turn about the body's z axis, roll about x, pitch about y, all right-handed and in that order:
    ``R = Rz(heading) Rx(roll) Ry(pitch)``. The chip's own Euler registers are not used: on real chips their heading has
    been seen to run the other way and their roll to be the turn about y (bdholt1/ros2_bno055_sensor, issue 3), and with
    firmware 03.11 they are distorted beyond some 20 deg of tilt (jetsonhacks/RTIMULib, pull request 1).
    """
    w, x, y, z = (float(part) for part in quaternion)
    heading = math.atan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z))
    roll = math.asin(max(-1.0, min(1.0, 2.0 * (y * z + w * x))))
    pitch = math.atan2(2.0 * (w * y - x * z), 1.0 - 2.0 * (x * x + y * y))
    return heading % (2.0 * math.pi), roll, pitch


def tilt(quaternion: FloatArray) -> float:
    """Return how far the body's z axis leans from the vertical, rad."""
    w, x, y, z = (float(part) for part in quaternion)
    return 2.0 * math.atan2(math.hypot(x, y), math.hypot(w, z))


def turn_between(one: FloatArray, other: FloatArray) -> float:
    """Return the angle (rad, 0 ... pi) by which two unit quaternions differ; q and -q are the same orientation."""
    return 2.0 * math.acos(min(1.0, abs(float(np.dot(one, other)))))


def up_in_body(quaternion: FloatArray) -> FloatArray:
    """Return the room's vertical as the body sees it, a unit vector."""
    w, x, y, z = (float(part) for part in quaternion)
    return np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])
