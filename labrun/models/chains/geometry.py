"""Compiled: where the bodies of a chain are, and how far its loop is open. Importing this imports numba.

Every joint places one body; the body that closes the loop is placed twice. `tree` holds the number of joints, which
joints place these two copies (-1: there is no loop), and of every joint which joint places the body it hangs on (-1:
the fixed one). `values`, a pointer or an array, holds gravity (3), the rate of stabilisation, and `PER_JOINT` numbers
of each joint.
"""

# ruff: noqa: ARG001 - numba reads the arguments of an intrinsic from its signature

import math
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import Pointer, kernel

PER_JOINT = 26
"""axis (3), at (3), axis in the body (3), at in the body (3), stiffness, damping, rest, torque; mass, centre (3),
inertia about it (xx, yy, zz, xy, xz, yz)."""
FIRST_JOINT = 4
TREE_HEAD = 3
ROWS = 6
"""Conditions of a closed loop: rotation vector, then distance."""


@intrinsic  # type: ignore[untyped-decorator]
def stacked(typing: Any, shape: Any) -> Any:
    """Return an array (of a tuple of lengths) on the stack, gone when the kernel that asked returns; not in a loop.

    Small arrays from the heap cost more time than what is computed in them.
    """
    array = types.Array(types.float64, len(shape), "C")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lengths = [
            context.cast(builder, length, kind, types.intp)
            for length, kind in zip(
                cgutils.unpack_tuple(builder, arguments[0]), signature.args[0], strict=True
            )
        ]
        strides: list[Any] = []
        count = cgutils.intp_t(1)
        for length in reversed(lengths):
            strides.insert(0, builder.mul(count, cgutils.intp_t(8)))
            count = builder.mul(count, length)
        array_struct = context.make_array(array)(context, builder)
        data = builder.alloca(ir.DoubleType(), size=count)
        populate_array(array_struct, data, lengths, strides, cgutils.intp_t(8), None)
        return array_struct._getvalue()

    return array(shape), generate


@kernel
def _unit(x: float, y: float, z: float, out: FloatArray) -> None:
    length = math.sqrt(x * x + y * y + z * z)
    out[0], out[1], out[2] = x / length, y / length, z / length


@kernel
def cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write a x b; `out` may be `a`."""
    x, y, z = a[0], a[1], a[2]
    out[0], out[1], out[2] = y * b[2] - z * b[1], z * b[0] - x * b[2], x * b[1] - y * b[0]


@kernel
def _rotation(axis: FloatArray, sine: float, cosine: float, out: FloatArray) -> None:
    """Write the matrix of a turn about a unit vector."""
    x, y, z = axis[0], axis[1], axis[2]
    rest = 1.0 - cosine
    out[0, 0], out[0, 1], out[0, 2] = cosine + x * x * rest, x * y * rest - z * sine, x * z * rest + y * sine
    out[1, 0], out[1, 1], out[1, 2] = x * y * rest + z * sine, cosine + y * y * rest, y * z * rest - x * sine
    out[2, 0], out[2, 1], out[2, 2] = x * z * rest - y * sine, y * z * rest + x * sine, cosine + z * z * rest


@kernel
def _onto(start: FloatArray, end: FloatArray, out: FloatArray) -> None:
    """Write the least turn that takes one unit vector to another."""
    across, other = stacked((3,)), stacked((3,))
    cross(start, end, across)
    sine = math.sqrt(across[0] ** 2 + across[1] ** 2 + across[2] ** 2)
    cosine = start[0] * end[0] + start[1] * end[1] + start[2] * end[2]
    if sine > 1e-12:
        for k in range(3):
            across[k] /= sine
        _rotation(across, sine, cosine, out)
        return
    if cosine < 0.0:  # half a turn about anything across
        for k in range(3):
            other[k] = 0.0
        other[0 if abs(start[0]) < 0.7 else 1] = 1.0
        cross(start, other, across)
        _unit(across[0], across[1], across[2], other)
        _rotation(other, 0.0, -1.0, out)
        return
    for row in range(3):
        for column in range(3):
            out[row, column] = 1.0 if row == column else 0.0


@kernel
def multiply(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write the product of two matrices (3, 3)."""
    for row in range(3):
        for column in range(3):
            out[row, column] = a[row, 0] * b[0, column] + a[row, 1] * b[1, column] + a[row, 2] * b[2, column]


@kernel
def turned(rotation: FloatArray, vector: FloatArray, out: FloatArray) -> None:
    """Write a matrix (3, 3) times a vector."""
    x, y, z = vector[0], vector[1], vector[2]
    for row in range(3):
        out[row] = rotation[row, 0] * x + rotation[row, 1] * y + rotation[row, 2] * z


@kernel
def set_poses(
    tree: IntArray, values: Pointer, x: Pointer, rotation: FloatArray, origin: FloatArray, axis: FloatArray,
    hinge: FloatArray,
) -> None:  # fmt: skip
    """Write where everything is, in the frame of the fixed body.

    Parameters
    ----------
    x : (at least joints,)
        Angles, rad.
    rotation, origin : (joints, 3, 3), (joints, 3)
        Of the body each joint places.
    axis, hinge : (joints, 3)
        Of each joint: its unit vector, and the point it turns about.
    """
    own, other, point = stacked((3,)), stacked((3,)), stacked((3,))
    turn, onto, both = stacked((3, 3)), stacked((3, 3)), stacked((3, 3))
    for joint in range(tree[0]):
        base, parent = FIRST_JOINT + PER_JOINT * joint, tree[TREE_HEAD + joint]
        _unit(values[base], values[base + 1], values[base + 2], own)
        _unit(values[base + 6], values[base + 7], values[base + 8], other)
        _onto(other, own, onto)
        _rotation(own, math.sin(x[joint]), math.cos(x[joint]), turn)
        multiply(turn, onto, both)
        for k in range(3):
            point[k] = values[base + 3 + k]
        if parent < 0:
            for row in range(3):
                axis[joint, row], hinge[joint, row] = own[row], point[row]
                for column in range(3):
                    rotation[joint, row, column] = both[row, column]
        else:
            turned(rotation[parent], own, axis[joint])
            turned(rotation[parent], point, hinge[joint])
            for k in range(3):
                hinge[joint, k] += origin[parent, k]
            multiply(rotation[parent], both, rotation[joint])
        for k in range(3):
            point[k] = values[base + 9 + k]
        turned(rotation[joint], point, other)
        for k in range(3):
            origin[joint, k] = hinge[joint, k] - other[k]


@kernel
def apart(
    tree: IntArray, values: Pointer, rotation: FloatArray, origin: FloatArray, hinge: FloatArray,
    error: FloatArray,
) -> None:  # fmt: skip
    """Write how far the two copies of the closing body are apart: rotation vector (rad), then distance (m)."""
    first, second = tree[1], tree[2]
    between, inverse, point = stacked((3, 3)), stacked((3, 3)), stacked((3,))
    for row in range(3):
        for column in range(3):
            inverse[row, column] = rotation[first, column, row]
    multiply(rotation[second], inverse, between)
    error[0] = 0.5 * (between[2, 1] - between[1, 2])
    error[1] = 0.5 * (between[0, 2] - between[2, 0])
    error[2] = 0.5 * (between[1, 0] - between[0, 1])
    sine = math.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
    cosine = 0.5 * (between[0, 0] + between[1, 1] + between[2, 2] - 1.0)
    if sine > 1e-9:
        stretch = math.atan2(sine, cosine) / sine
        for k in range(3):
            error[k] *= stretch
    elif cosine < 0.0:
        error[0] = math.pi
    base = FIRST_JOINT + PER_JOINT * second
    for k in range(3):
        point[k] = values[base + 9 + k]
    turned(rotation[first], point, error[3:])
    for k in range(3):
        error[3 + k] = hinge[second, k] - origin[first, k] - error[3 + k]


@kernel
def moves(tree: IntArray, joint: int, body: int) -> float:
    """Return 1 where a joint moves the body another joint places, else 0."""
    while body > joint:
        body = tree[TREE_HEAD + body]
    return 1.0 if body == joint else 0.0


@kernel
def closing_jacobian(tree: IntArray, axis: FloatArray, hinge: FloatArray, jacobian: FloatArray) -> None:
    """Write the derivative of `apart` by the angles, (6, joints); exact where the loop is closed."""
    first, second = tree[1], tree[2]
    arm, swept = stacked((3,)), stacked((3,))
    for joint in range(tree[0]):
        sign = moves(tree, joint, second) - moves(tree, joint, first)
        for k in range(3):
            arm[k] = hinge[second, k] - hinge[joint, k]
        cross(axis[joint], arm, swept)
        for k in range(3):
            jacobian[k, joint] = sign * axis[joint, k]
            jacobian[3 + k, joint] = sign * swept[k]
