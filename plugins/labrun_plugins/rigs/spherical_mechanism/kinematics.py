"""Kinematics of the two-axis spherical parallel mechanism (SPM): sections 2.2 and 4.2 of the source work.

Five rigid links, five hinges whose axes meet in one point, every link arc 90 degrees. Servo 1 turns about the x axis of
the chassis, servo 2 about its y axis; the end-effector is carried by the chain of servo 2. Its orientation is told by
the unit vector N normal to it, (0, 0, 1) in the chassis' frame when both servos stand at zero.

Misprints of the source that are mended here:

- (2.5), (2.7) and, again, (4.8), (4.10) print ``t1 + t1 t2`` (t_i = tan theta_i). By the inverse kinematics
  ``N_Y / N_Z = t1 (1 + t2^2)``, so it must be ``t1 + t1 t2^2``. As printed, the pair does not
  invert: servo angles of (30, 20) deg come back as (34.81, 20.00) deg. The mended pair is that of the true geometry.
- (2.4) is written with atan; atan2 keeps the sign where N_Z = 0 (the case of (4.7)).
- (2.2), the inverse Jacobian: rows 1 and 3 as printed are not orthogonal, and row 2 fits no frame. `inverse_jacobian`
  has it free of coordinates, from the hinge axes.

Signs: a rising theta_1 turns N towards +y, so the axis of servo 1 points along -x; a rising theta_2 turns N towards
+x, about +y. Angles in rad. Every function takes scalars or arrays of one shape and is vectorised over them.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrun.errors import ModelError

FloatArray = NDArray[np.float64]

_RIGHT_ANGLE = np.pi / 2
_LEAST = 1e-12
"""Below this, sine and cosine cannot tell a direction: what is closer to a singular pose counts as one."""


def forward(theta_1: ArrayLike, theta_2: ArrayLike) -> FloatArray:
    """Return the normal N of the end-effector for servo angles: (2.5)-(2.7) as corrected.

    ``q = t1 + t1 t2^2``, ``N_Z = 1 / sqrt(q^2 + t2^2 + 1)``, ``N_X = t2 N_Z``, ``N_Y = q N_Z``.

    Parameters
    ----------
    theta_1, theta_2 : (...)
        Servo angles, rad, between -90 and 90 degrees.

    Returns
    -------
    (..., 3)
        Unit vectors in the frame of the chassis.

    Raises
    ------
    ModelError
        An angle is not within -90 ... 90 degrees (exclusive): there N is not determined.
    """
    first, second = _within_workspace(theta_1, theta_2)
    t2 = np.tan(second)
    q = np.tan(first) * (1.0 + t2**2)
    z = 1.0 / np.sqrt(q**2 + t2**2 + 1.0)
    return np.stack([t2 * z, q * z, z], axis=-1)


def inverse(normal: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the servo angles that turn the end-effector's normal to N: (2.3), (2.4), (4.7).

    ``theta_1 = atan(N_Y N_Z / (N_X^2 + N_Z^2))``, ``theta_2 = atan2(N_X, N_Z)``.

    Parameters
    ----------
    normal : (..., 3)
        Directions in the frame of the chassis, of any length, with N_Z >= 0. With N_Z = 0 the source's special case
        holds: theta_1 = 0, theta_2 = +-90 degrees.

    Returns
    -------
    theta_1, theta_2 : (...)
        Servo angles, rad.

    Raises
    ------
    ModelError
        N = +-Y, where the mechanism is singular (0/0); N_Z below 0, where the chassis is; or no direction at all.
    """
    n = np.asarray(normal, dtype=np.float64)
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    if not np.all(np.isfinite(n)) or np.any(length == 0.0):
        raise ModelError(
            "the normal of the end-effector must be a direction: three finite numbers, not all 0"
        )
    x, y, z = np.moveaxis(n / length, -1, 0)
    if np.any(np.hypot(x, z) < _LEAST):
        raise ModelError(
            "the end-effector's normal along the y axis is a singular pose: theta_2 is not determined there",
            hint="keep it away from (0, 1, 0) and (0, -1, 0)",
        )
    if np.any(z < 0.0):
        raise ModelError(
            f"the end-effector's normal points below the chassis (N_Z = {float(np.min(z)):.3g})",
            hint="its workspace is the half space N_Z >= 0",
        )
    return np.arctan(y * z / (x**2 + z**2)), np.arctan2(x, z)


def rotation(theta_1: ArrayLike, theta_2: ArrayLike) -> FloatArray:
    """Return the whole rotation of the end-effector, ``R = Ry(theta_2) Rx(-phi)``, ``tan phi = t1 / cos theta_2``.

    Not in the source, which has only N, its third column; the turn about N follows from the geometry.

    Returns
    -------
    (..., 3, 3)
        From the end-effector's frame to that of the chassis.

    Raises
    ------
    ModelError
        As `forward`.
    """
    first, second = _within_workspace(theta_1, theta_2)
    phi = np.arctan2(np.tan(first), np.cos(second))
    c2, s2, cp, sp = np.cos(second), np.sin(second), np.cos(phi), np.sin(phi)
    zero = np.zeros_like(c2)
    rows = [[c2, -s2 * sp, s2 * cp], [zero, cp, sp], [-s2, -c2 * sp, c2 * cp]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def inverse_jacobian(theta_1: ArrayLike, theta_2: ArrayLike) -> FloatArray:
    """Return the matrix that takes the end-effector's angular velocity to (theta_1', theta_2', 0): in place of (2.2).

    With a_A the axis of the servo whose chain carries the end-effector (servo 2), a_B the other one's, p and r the
    passive axes next to them, and ``w = p x r / |p x r|`` the axis of the coupler::

        theta_A' = a_A . omega
        theta_B' = (r x w) . omega / (a_B . (r x w))
        0        = (a_A x p) . omega

    Returns
    -------
    (..., 3, 3)
        Rows: servo 1, servo 2, constraint (a velocity with a component along it cannot be). omega in rad/s, in the
        frame of the chassis.

    Raises
    ------
    ModelError
        As `forward`.
    """
    first, second = _within_workspace(theta_1, theta_2)
    zero, ones = np.zeros_like(first), np.ones_like(first)
    a_carrying = np.stack([zero, ones, zero], axis=-1)
    a_other = np.stack([-ones, zero, zero], axis=-1)
    p = np.stack([np.cos(second), zero, -np.sin(second)], axis=-1)
    r = np.stack([zero, np.sin(first), np.cos(first)], axis=-1)
    w = np.cross(p, r)
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    lever = np.cross(r, w)
    other_row = lever / np.sum(a_other * lever, axis=-1, keepdims=True)
    return np.stack([other_row, a_carrying, np.cross(a_carrying, p)], axis=-2)


def jacobian(theta_1: ArrayLike, theta_2: ArrayLike) -> FloatArray:
    """Return the matrix that takes (theta_1', theta_2') to the end-effector's angular velocity, shape (..., 3, 2).

    The first two columns of the inverse of `inverse_jacobian`; raises as it does.
    """
    return np.asarray(np.linalg.inv(inverse_jacobian(theta_1, theta_2))[..., :, :2])


def tilt(normal: ArrayLike) -> FloatArray:
    """Return how far N leans towards y and x, ``psi = (atan2(N_Y, N_Z), atan2(N_X, N_Z))``, shape (..., 2), rad."""
    x, y, z = np.moveaxis(np.asarray(normal, dtype=np.float64), -1, 0)
    return np.stack([np.arctan2(y, z), np.arctan2(x, z)], axis=-1)


def linearised_tilt(theta_1: ArrayLike, theta_2: ArrayLike) -> FloatArray:
    """Return `tilt` by the linearisation about N = (0, 0, 1), ``psi = I theta``: (2.8)-(2.12), shape (..., 2), rad.

    It is what a stabiliser with one loop per axis relies on. Its largest error over a square of servo angles: 0.04 deg
    within +-5 deg, 0.30 within +-10, 1.0 within +-15, 2.4 within +-20, 7.6 within +-30. All of it is in psi_1; psi_2 is
    exact.
    """
    first, second = np.broadcast_arrays(
        np.asarray(theta_1, dtype=np.float64), np.asarray(theta_2, dtype=np.float64)
    )
    return np.stack([first, second], axis=-1)


def _within_workspace(theta_1: ArrayLike, theta_2: ArrayLike) -> tuple[FloatArray, FloatArray]:
    first, second = np.broadcast_arrays(
        np.asarray(theta_1, dtype=np.float64), np.asarray(theta_2, dtype=np.float64)
    )
    for name, angle in (("theta_1", first), ("theta_2", second)):
        if not np.all(np.abs(angle) < _RIGHT_ANGLE - _LEAST):
            worst = float(angle.flat[int(np.argmax(np.where(np.isnan(angle), np.inf, np.abs(angle))))])
            raise ModelError(
                f"{name} = {np.degrees(worst):.4g} deg: the mechanism is singular at +-90 deg",
                hint="keep both servos between -90 and 90 deg",
            )
    return first, second
