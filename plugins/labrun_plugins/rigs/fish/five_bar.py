"""The pectoral fin's mechanism: a spherical five-bar whose five arcs are all 72 degrees.

Five hinge axes meet in one point: two servo axes on the body, one axis at the end of each servo's link, and
the axis at which the two outer links meet. Five arcs of 72 degrees make a full turn, so that the mechanism
folds from a flat sheet: all axes in one plane, both servos at zero (section 6.1 of the source work, which
gives no kinematics; the closed forms of its chapters 2 and 4 hold for arcs of 90 degrees only).

How the loop is closed. Servo angles place the two link ends; the meeting axis is where the circles of 72
degrees about them cross. That is solved with vectors, without a choice of frames or passive angles, and
exactly: an iteration on the closure would stall at the flat state, where its Jacobian is singular.

Flat is not only singular, it is a crossing of branches, and beside it no loop closes when the servos turn
against each other: the outer links are then stretched. In the coordinates ``u = theta_1 + theta_2`` and ``v =
theta_1 - theta_2`` a loop closes for ``|v| <= v_max(u)``, with ``v_max(0) = 0``. Two choices make the motion
unique and smooth (chosen for the simulation; the source is silent). The outer links fold to the side of the
sign of `u`, so that the sheet goes smoothly through flat. And where servos are told to stretch the outer
links, the laminate bends and the servos yield: `v` is not stopped hard, it saturates smoothly,

    ``v -> v / (1 + (v / m)^4)^(1/4)``,
    ``m(u) = s u^2 / sqrt(u^2 + 0.4^2) / (1 + (s u / 2.4)^4)^(1/4)``,  ``s = v_max'(0) = 2.058``.

The limit `m` follows `v_max` where it can, and stays below 85 % of it everywhere, because `v_max` itself has a
corner (at u = 0.785) and a crossing must never become a touching, where speeds would be infinite. It leaves
angles well inside alone (1.5 % less at half of `m`), and brings `v` to zero without a kink where the sheet is
flat.
"""

import math

import numpy as np

from labrun.devices import FloatArray
from labrun.models import kernel

ARC_RAD = 2.0 * math.pi / 5.0
_C = math.cos(ARC_RAD)
_S = math.sin(ARC_RAD)
_HALF = ARC_RAD / 2.0
_REACH = math.cos(2.0 * ARC_RAD)
_FLAT_SLOPE = 2.058
_FLAT_RAD = 0.4
_WIDEST_RAD = 2.4
_MOST_RAD = math.radians(100.0)


@kernel
def greatest_difference(sum_rad: float) -> float:
    """Return `v_max`: the greatest ``|theta_1 - theta_2|`` at which the loop closes, given their sum.

    With ``y = cos(v/2)`` the cosine between the link ends is quadratic in `y`; at the limit they are two
    arcs apart.
    """
    linear = _C * _S * _S * math.cos(sum_rad / 2.0)
    square = _S * _S * (1.0 - _C)
    constant = (
        _C**3
        - 0.5 * _C * _S * _S * (math.cos(sum_rad) - 1.0)
        - 0.5 * _S * _S * (1.0 + math.cos(sum_rad))
        - _REACH
    )
    root = math.sqrt(max(0.0, linear * linear - square * constant))
    least = (linear + root) / square
    return 2.0 * math.acos(max(-1.0, min(1.0, least)))


@kernel
def reached(theta_1: float, theta_2: float) -> tuple[float, float]:
    """Return the angles the servos really reach, rad: their sum goes through, their difference saturates."""
    first = max(-_MOST_RAD, min(_MOST_RAD, theta_1))
    second = max(-_MOST_RAD, min(_MOST_RAD, theta_2))
    total, difference = first + second, first - second
    straight = _FLAT_SLOPE * total * total / math.sqrt(total * total + _FLAT_RAD * _FLAT_RAD)
    bend = (_FLAT_SLOPE * total / _WIDEST_RAD) ** 2
    most = straight / math.sqrt(math.sqrt(1.0 + bend * bend))
    # The same as in the module's docstring, without dividing by a limit that may be zero.
    square, most_square = difference * difference, most * most
    sizes = math.sqrt(math.sqrt(square * square + most_square * most_square))
    if sizes > 0.0:
        difference *= most / sizes
    return 0.5 * (total + difference), 0.5 * (total - difference)


@kernel
def link_axes(theta_1: float, theta_2: float, axes: FloatArray) -> None:
    """Write the three moving axes for servo angles at which the loop closes.

    Coordinates: outward from the body, along the sheet, normal to the flat sheet. Positive angles lift
    towards the normal.

    Parameters
    ----------
    theta_1, theta_2
        Servo angles, rad, as `reached` returns them.
    axes : (3, 3)
        Receives unit vectors: end of link 1, end of link 2, meeting axis.
    """
    # Servo axes stand 36 degrees to both sides of inward; at zero the link ends are 108 degrees from inward.
    for link in range(2):
        side = 1.0 if link == 0 else -1.0
        angle = theta_1 if link == 0 else theta_2
        axis_out, axis_along = -math.cos(_HALF), side * math.sin(_HALF)
        # In the sheet, a quarter turn from the servo axis, away from the other servo.
        quarter_out, quarter_along = math.sin(_HALF), side * math.cos(_HALF)
        axes[link, 0] = _C * axis_out + _S * math.cos(angle) * quarter_out
        axes[link, 1] = _C * axis_along + _S * math.cos(angle) * quarter_along
        axes[link, 2] = _S * math.sin(angle)
    p0, p1, p2 = axes[0, 0], axes[0, 1], axes[0, 2]
    q0, q1, q2 = axes[1, 0], axes[1, 1], axes[1, 2]
    cosine = p0 * q0 + p1 * q1 + p2 * q2
    middle = _C / (1.0 + cosine)
    # Squares of the height above the plane of the two link ends, and of the length of their cross product.
    height = math.sqrt(max(0.0, 1.0 - 2.0 * _C * _C / (1.0 + cosine)))
    normal_0, normal_1, normal_2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
    length = math.sqrt(normal_0 * normal_0 + normal_1 * normal_1 + normal_2 * normal_2)
    if theta_1 + theta_2 < 0.0:
        height = -height
    scale = height / length
    axes[2, 0] = middle * (p0 + q0) + scale * normal_0
    axes[2, 1] = middle * (p1 + q1) + scale * normal_1
    axes[2, 2] = middle * (p2 + q2) + scale * normal_2


def hinge_axes(theta_1: float, theta_2: float) -> FloatArray:
    """Return servo 1, link 1, meeting axis, link 2 and servo 2: the loop in its order, shape (5, 3).

    Raises ValueError: no loop closes at these servo angles.
    """
    if abs(theta_1 - theta_2) > greatest_difference(theta_1 + theta_2) + 1e-12:
        raise ValueError(
            f"no loop closes at servo angles {theta_1:.4f} and {theta_2:.4f} rad: the outer links are stretched"
        )
    moving = np.empty((3, 3))
    link_axes(theta_1, theta_2, moving)
    servo_1 = np.array([-math.cos(_HALF), math.sin(_HALF), 0.0])
    servo_2 = np.array([-math.cos(_HALF), -math.sin(_HALF), 0.0])
    return np.stack([servo_1, moving[0], moving[2], moving[1], servo_2])
