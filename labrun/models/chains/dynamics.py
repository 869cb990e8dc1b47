"""Compiled: the dynamics of a tree of hinged bodies with one loop. Importing this imports numba.

The two copies of the body that closes the loop carry half its mass and inertia each, and are held together by
constraint forces. Those follow from the acceleration of the constraint,

    J q'' + J' q' + 2 w (J q') + w^2 e = 0,

where `e` is how far the copies are apart (`labrun.models.chains.geometry.apart`) and `w` the rate at which an error
decays (Baumgarte, Comp. Meth. Appl. Mech. Eng. 1 (1972) 1, critically damped). A spherical or a planar loop needs 3 of
the 6 rows: pivoting leaves out what depends on others.
"""

# ruff: noqa: ARG001 - all functions called by address have the signature of a model

import math

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import Pointer, kernel, native
from labrun.models.chains.geometry import (
    FIRST_JOINT,
    PER_JOINT,
    ROWS,
    TREE_HEAD,
    apart,
    closing_jacobian,
    cross,
    multiply,
    set_poses,
    stacked,
    turned,
)

_DEPENDENT = 1e-10
"""Share of the largest pivot below which a row depends on those before it."""


@kernel
def factored(matrix: FloatArray) -> bool:
    """Replace a symmetric matrix by its Cholesky factor L (lower, diagonal inverted); tell whether it is positive."""
    size = matrix.shape[0]
    for column in range(size):
        before = matrix[column, column]
        for k in range(column):
            matrix[column, column] -= matrix[column, k] ** 2
        if not matrix[column, column] > 1e-12 * before:
            return False
        inverse = 1.0 / math.sqrt(matrix[column, column])
        matrix[column, column] = inverse
        for row in range(column + 1, size):
            for k in range(column):
                matrix[row, column] -= matrix[row, k] * matrix[column, k]
            matrix[row, column] *= inverse
    return True


@kernel
def forward(factor: FloatArray, right: FloatArray) -> None:
    """Replace a right-hand side by L^-1 times it, given the factor L of `factored`."""
    for row in range(factor.shape[0]):
        rest = right[row]
        for k in range(row):
            rest -= factor[row, k] * right[k]
        right[row] = rest * factor[row, row]


@kernel
def backward(factor: FloatArray, right: FloatArray) -> None:
    """Replace a right-hand side by L^-T times it: after `forward`, the solution."""
    size = factor.shape[0]
    for row in range(size - 1, -1, -1):
        rest = right[row]
        for k in range(row + 1, size):
            rest -= factor[k, row] * right[k]
        right[row] = rest * factor[row, row]


@kernel
def solved_where_independent(matrix: FloatArray, right: FloatArray) -> None:
    """Solve a positive semidefinite system by pivoted Cholesky; what depends on other rows gets 0."""
    size = matrix.shape[0]
    order, largest, rank = np.arange(size), 0.0, 0
    for step in range(size):
        best = step
        for k in range(step + 1, size):
            if matrix[order[k], order[k]] > matrix[order[best], order[best]]:
                best = k
        order[step], order[best] = order[best], order[step]
        here = order[step]
        pivot = matrix[here, here]
        largest = max(largest, pivot)
        if not pivot > _DEPENDENT * largest:
            break
        rank += 1
        root = math.sqrt(pivot)
        matrix[here, here] = root
        for k in range(step + 1, size):
            matrix[order[k], here] /= root
        for k in range(step + 1, size):
            for other in range(step + 1, k + 1):
                rest = matrix[order[k], order[other]] - matrix[order[k], here] * matrix[order[other], here]
                matrix[order[k], order[other]] = matrix[order[other], order[k]] = rest
    for step in range(rank):
        here = order[step]
        for k in range(step):
            right[here] -= matrix[here, order[k]] * right[order[k]]
        right[here] /= matrix[here, here]
    for step in range(rank - 1, -1, -1):
        here = order[step]
        for k in range(step + 1, rank):
            right[here] -= matrix[order[k], here] * right[order[k]]
        right[here] /= matrix[here, here]
    for step in range(rank, size):
        right[order[step]] = 0.0


@kernel
def _share(tree: IntArray, joint: int) -> float:
    """Return which part of its body's mass the copy that a joint places carries."""
    return 0.5 if joint in (tree[1], tree[2]) else 1.0


@kernel
def unconstrained(
    tree: IntArray, values: Pointer, x: Pointer, force: Pointer, rotation: FloatArray, origin: FloatArray,
    axis: FloatArray, hinge: FloatArray, mass: FloatArray, push: FloatArray, drift: FloatArray,
) -> None:  # fmt: skip
    """Write mass matrix and generalized forces of the tree, and how the loop would accelerate at constant rates.

    Parameters
    ----------
    x : (2 * joints,)
        Angles, then rates.
    force : (joints,)
        Added at each joint, N m.
    mass, push : (joints, joints), (joints,)
        ``mass q'' = push`` but for the loop.
    drift : (6,)
        ``J' q'``.
    """
    count = tree[0]
    set_poses(tree, values, x, rotation, origin, axis, hinge)
    for joint in range(count):
        base = FIRST_JOINT + PER_JOINT * joint
        push[joint] = (
            force[joint] + values[base + 15] - values[base + 13] * x[count + joint]
            - values[base + 12] * (x[joint] - values[base + 14])
        )  # fmt: skip
        for k in range(count):
            mass[joint, k] = 0.0
    spin, gain, carried = stacked((count, 3)), stacked((count, 3)), stacked((count, 3))
    _move(tree, x, origin, axis, hinge, spin, gain, carried)
    _weigh(tree, values, rotation, origin, axis, hinge, spin, gain, carried, mass, push)
    if tree[1] >= 0:
        _drift(tree, origin, hinge, spin, gain, carried, drift)


@kernel
def _move(
    tree: IntArray, x: Pointer, origin: FloatArray, axis: FloatArray, hinge: FloatArray, spin: FloatArray,
    gain: FloatArray, carried: FloatArray,
) -> None:  # fmt: skip
    """Write angular velocity of every body, and angular acceleration and that of its origin at constant rates."""
    arm, part, pull = stacked((3,)), stacked((3,)), stacked((3,))
    for joint in range(tree[0]):
        rate, parent = x[tree[0] + joint], tree[TREE_HEAD + joint]
        for k in range(3):
            spin[joint, k], gain[joint, k], carried[joint, k] = 0.0, 0.0, 0.0
        if parent >= 0:
            for k in range(3):
                arm[k] = hinge[joint, k] - origin[parent, k]
            cross(spin[parent], arm, part)
            cross(spin[parent], part, pull)
            cross(gain[parent], arm, part)
            for k in range(3):
                carried[joint, k] = carried[parent, k] + part[k] + pull[k]
            cross(spin[parent], axis[joint], part)
            for k in range(3):
                spin[joint, k], gain[joint, k] = spin[parent, k], gain[parent, k] + part[k] * rate
        for k in range(3):
            spin[joint, k] += axis[joint, k] * rate
            arm[k] = origin[joint, k] - hinge[joint, k]
        cross(spin[joint], arm, part)
        cross(spin[joint], part, pull)
        cross(gain[joint], arm, part)
        for k in range(3):
            carried[joint, k] += part[k] + pull[k]


@kernel
def _weigh(
    tree: IntArray, values: Pointer, rotation: FloatArray, origin: FloatArray, axis: FloatArray,
    hinge: FloatArray, spin: FloatArray, gain: FloatArray, carried: FloatArray, mass: FloatArray,
    push: FloatArray,
) -> None:  # fmt: skip
    """Add every body, weight and inertia, to the joints that move it."""
    count = tree[0]
    part, pull, torque, inertia = stacked((3,)), stacked((3,)), stacked((3,)), stacked((3, 3))
    centre, lever, sweeps = stacked((3,)), stacked((3,)), stacked((count, 3))
    for joint in range(count):
        base = FIRST_JOINT + PER_JOINT * joint
        share = _share(tree, joint)
        kilograms = share * values[base + 16]
        for k in range(3):
            part[k] = values[base + 17 + k]
        turned(rotation[joint], part, centre)
        cross(spin[joint], centre, part)
        cross(spin[joint], part, pull)
        cross(gain[joint], centre, part)
        for k in range(3):
            pull[k] = kilograms * (values[k] - carried[joint, k] - part[k] - pull[k])
            centre[k] += origin[joint, k]
        _inertia(values, base, share, rotation[joint], inertia)
        turned(inertia, spin[joint], part)
        cross(spin[joint], part, torque)
        turned(inertia, gain[joint], part)
        for k in range(3):
            torque[k] = -torque[k] - part[k]
        current = joint
        while current >= 0:
            for k in range(3):
                lever[k] = centre[k] - hinge[current, k]
            cross(axis[current], lever, sweeps[current])
            turned(inertia, axis[current], part)
            for k in range(3):
                push[current] += sweeps[current, k] * pull[k] + axis[current, k] * torque[k]
                lever[k] = kilograms * sweeps[current, k]
            other = joint
            while other >= current:
                added = 0.0
                for k in range(3):
                    added += sweeps[other, k] * lever[k] + axis[other, k] * part[k]
                mass[current, other] += added
                if other != current:
                    mass[other, current] += added
                other = tree[TREE_HEAD + other]
            current = tree[TREE_HEAD + current]


@kernel
def _drift(
    tree: IntArray, origin: FloatArray, hinge: FloatArray, spin: FloatArray, gain: FloatArray,
    carried: FloatArray, drift: FloatArray,
) -> None:  # fmt: skip
    """Write how the two copies of the closing body would accelerate apart at constant rates."""
    arm, part, pull = stacked((3,)), stacked((3,)), stacked((3,))
    for k in range(ROWS):
        drift[k] = 0.0
    for end in range(2):
        body, sign = tree[1 + end], 2.0 * end - 1.0
        for k in range(3):
            arm[k] = hinge[tree[2], k] - origin[body, k]
        cross(spin[body], arm, part)
        cross(spin[body], part, pull)
        cross(gain[body], arm, part)
        for k in range(3):
            drift[k] += sign * gain[body, k]
            drift[3 + k] += sign * (carried[body, k] + part[k] + pull[k])


@kernel
def _inertia(values: Pointer, base: int, share: float, rotation: FloatArray, out: FloatArray) -> None:
    """Write a body's inertia about its centre as it is turned."""
    own, half = stacked((3, 3)), stacked((3, 3))
    for k in range(3):
        own[k, k] = share * values[base + 20 + k]
    own[0, 1] = own[1, 0] = share * values[base + 23]
    own[0, 2] = own[2, 0] = share * values[base + 24]
    own[1, 2] = own[2, 1] = share * values[base + 25]
    multiply(rotation, own, half)
    for row in range(3):
        for column in range(3):
            out[row, column] = (
                half[row, 0] * rotation[column, 0]
                + half[row, 1] * rotation[column, 1]
                + half[row, 2] * rotation[column, 2]
            )


@kernel
def slope(tree: IntArray, values: Pointer, x: Pointer, force: Pointer, out: Pointer) -> None:
    """Write the derivative of all angles and rates; NaN where a joint moves nothing that has inertia."""
    count = tree[0]
    rotation, origin = stacked((count, 3, 3)), stacked((count, 3))
    axis, hinge = stacked((count, 3)), stacked((count, 3))
    mass, push, drift = stacked((count, count)), stacked((count,)), stacked((ROWS,))
    unconstrained(tree, values, x, force, rotation, origin, axis, hinge, mass, push, drift)
    for joint in range(count):
        out[joint] = x[count + joint]
    if not factored(mass):
        for joint in range(count):
            out[count + joint] = math.nan
        return
    forward(mass, push)
    if tree[1] >= 0:
        _hold_together(tree, values, x, rotation, origin, axis, hinge, mass, push, drift)
    backward(mass, push)
    for joint in range(count):
        out[count + joint] = push[joint]


@kernel
def _product(first: FloatArray, other: FloatArray) -> float:
    total = 0.0
    for k in range(first.size):
        total += first[k] * other[k]
    return total


@kernel
def _comparable(rows: FloatArray, turning: int) -> float:
    """Make rows in m comparable to the `turning` first ones, in rad, by their size; return the factor."""
    turns, shifts = 0.0, 0.0
    for row in range(turning):
        turns = max(turns, math.sqrt(_product(rows[row], rows[row])))
    for row in range(turning, rows.shape[0]):
        shifts = max(shifts, math.sqrt(_product(rows[row], rows[row])))
    scale = turns / shifts if shifts > 1e-9 * turns else 0.0
    for row in range(turning, rows.shape[0]):
        for k in range(rows.shape[1]):
            rows[row, k] *= scale
    return scale


@kernel
def _hold_together(
    tree: IntArray, values: Pointer, x: Pointer, rotation: FloatArray, origin: FloatArray, axis: FloatArray,
    hinge: FloatArray, factor: FloatArray, pushed: FloatArray, drift: FloatArray,
) -> None:  # fmt: skip
    """Add the loop's constraint forces to the others, L^-1 (see `factored`) times both."""
    count, rate = tree[0], values[3]
    jacobian, error, response = stacked((ROWS, count)), stacked((ROWS,)), stacked((ROWS, ROWS))
    closing_jacobian(tree, axis, hinge, jacobian)
    apart(tree, values, rotation, origin, hinge, error)
    kept, turning = 0, 0  # what no joint changes, as the distance in a spherical loop, needs no force
    for row in range(ROWS):
        moving, moved = 0.0, False
        for joint in range(count):
            jacobian[kept, joint] = jacobian[row, joint]
            moving += jacobian[row, joint] * x[count + joint]
            moved = moved or jacobian[row, joint] != 0.0
        if not moved:
            continue
        forward(factor, jacobian[kept])
        drift[kept] = -(
            _product(jacobian[kept], pushed) + drift[row] + 2.0 * rate * moving + rate * rate * error[row]
        )
        kept += 1
        turning = kept if row < 3 else turning
    scale = _comparable(jacobian[:kept], turning)
    for row in range(kept):
        drift[row] *= 1.0 if row < turning else scale
        for column in range(row + 1):
            response[row, column] = response[column, row] = _product(jacobian[row], jacobian[column])
    solved_where_independent(response[:kept, :kept], drift[:kept])
    for row in range(kept):
        for joint in range(count):
            pushed[joint] += jacobian[row, joint] * drift[row]


@kernel
def measures(tree: IntArray, values: Pointer, x: Pointer, out: Pointer) -> None:
    """Write how far the loop is open (rad, m), and kinetic and potential energy (J)."""
    count = tree[0]
    rotation, origin = stacked((count, 3, 3)), stacked((count, 3))
    axis, hinge = stacked((count, 3)), stacked((count, 3))
    mass, push, drift = stacked((count, count)), stacked((count,)), stacked((ROWS,))
    unconstrained(tree, values, x, np.zeros(count), rotation, origin, axis, hinge, mass, push, drift)
    out[0], out[1] = 0.0, 0.0
    if tree[1] >= 0:
        error = stacked((ROWS,))
        apart(tree, values, rotation, origin, hinge, error)
        out[0] = math.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
        out[1] = math.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)
    kinetic, potential, centre, point = 0.0, 0.0, stacked((3,)), stacked((3,))
    for joint in range(count):
        base = FIRST_JOINT + PER_JOINT * joint
        for other in range(count):
            kinetic += 0.5 * x[count + joint] * mass[joint, other] * x[count + other]
        potential += 0.5 * values[base + 12] * (x[joint] - values[base + 14]) ** 2
        for k in range(3):
            centre[k] = values[base + 17 + k]
        turned(rotation[joint], centre, point)
        for k in range(3):
            potential -= _share(tree, joint) * values[base + 16] * values[k] * (point[k] + origin[joint, k])
    out[2], out[3] = kinetic, potential


@kernel
def _whole(tree: Pointer) -> IntArray:
    """Return the tree, which comes as floats, as it is counted in."""
    result = np.empty(TREE_HEAD + int(tree[0]), dtype=np.int64)
    for k in range(result.size):
        result[k] = int(tree[k])
    return result


def chain_slope(t: float, x: Pointer, values: Pointer, tree: Pointer, force: Pointer, out: Pointer) -> None:
    """Do as `slope`, with the signature of a model: compiled once for all chains, and called by address."""
    slope(_whole(tree), values, x, force, out)


def chain_measures(
    t: float, x: Pointer, values: Pointer, tree: Pointer, force: Pointer, out: Pointer
) -> None:
    """Do as `measures`, with the signature of a model."""
    measures(_whole(tree), values, x, out)


SLOPE = native("model", chain_slope)
MEASURED = native("model", chain_measures)
