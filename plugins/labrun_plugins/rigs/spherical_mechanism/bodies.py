"""Where the stabiliser's two bodies point in the room: unit quaternions, angular velocities, tilts."""

import math

import numpy as np

from labrun.devices import FloatArray
from labrun.models import kernel

BODIES = ("base", "end_effector")
SIGNALS = (
    ("qw", "1"),
    ("qx", "1"),
    ("qy", "1"),
    ("qz", "1"),
    ("wx", "rad/s"),
    ("wy", "rad/s"),
    ("wz", "rad/s"),
    ("tilt", "rad"),
)
"""What is known of each body: orientation in the room, angular velocity in its own frame, lean of its normal."""


@kernel
def orientations(angles: FloatArray, before: FloatArray, step_s: float, farthest_rad: float) -> FloatArray:
    """Return the signals of both bodies, shape (n, 2 * 8).

    The base stands at ``Ry(base_y) Rx(base_x)``, the end-effector turns against it by ``Ry(theta_2) Rx(-phi)``,
    ``tan phi = tan theta_1 / cos theta_2``; see `kinematics`. Compiled, so that the numbers do not depend on how
    many are asked for at once.

    Parameters
    ----------
    angles : (n, 4)
        theta_1, theta_2, base_x, base_y at ascending grid points, rad.
    before : (2, 4)
        Quaternions (w, x, y, z) of the bodies at the grid point before; overwritten with the last ones.
    step_s
        Grid step.
    farthest_rad
        Where the mechanism's links meet their stops.
    """
    rows = np.empty((len(angles), 16))
    body = np.empty((2, 4))
    for i in range(len(angles)):
        theta_1 = min(max(angles[i, 0], -farthest_rad), farthest_rad)
        theta_2 = min(max(angles[i, 1], -farthest_rad), farthest_rad)
        phi = math.atan2(math.tan(theta_1), math.cos(theta_2))
        _y_then_x(angles[i, 3], angles[i, 2], body[0])
        relative = np.empty(4)
        _y_then_x(theta_2, -phi, relative)
        _product(body[0], relative, body[1])
        for k in range(2):
            w, x, y, z = body[k]
            _product(np.array([before[k, 0], -before[k, 1], -before[k, 2], -before[k, 3]]), body[k], relative)
            length = math.sqrt(relative[1] ** 2 + relative[2] ** 2 + relative[3] ** 2)
            rate = 2.0 / step_s
            if length > 1e-12:
                rate *= math.atan2(length, relative[0]) / length
            at = 8 * k
            rows[i, at], rows[i, at + 1], rows[i, at + 2], rows[i, at + 3] = w, x, y, z
            rows[i, at + 4], rows[i, at + 5], rows[i, at + 6] = (
                rate * relative[1], rate * relative[2], rate * relative[3],
            )  # fmt: skip
            across = math.hypot(2.0 * (x * z + w * y), 2.0 * (y * z - w * x))
            rows[i, at + 7] = math.atan2(across, 1.0 - 2.0 * (x * x + y * y))
            before[k, 0], before[k, 1], before[k, 2], before[k, 3] = w, x, y, z
    return rows


@kernel
def _y_then_x(about_y: float, about_x: float, out: FloatArray) -> None:
    """Write the quaternion of ``Ry(about_y) Rx(about_x)``."""
    cy, sy = math.cos(0.5 * about_y), math.sin(0.5 * about_y)
    cx, sx = math.cos(0.5 * about_x), math.sin(0.5 * about_x)
    out[0], out[1], out[2], out[3] = cy * cx, cy * sx, sy * cx, -sy * sx


@kernel
def _product(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write the product of two quaternions (w, x, y, z)."""
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
