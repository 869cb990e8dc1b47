"""Where a closed chain begins: angles at which its loop is closed, at rest where that is asked for, and rates that fit.

Closing is a least-squares problem (Newton's shortest steps where it is nearly closed, else a trust region from SciPy),
which takes loops whose six conditions depend on one another as they are. Rest is the least potential energy along the
loop: Newton's method in the null space of the constraint (Nocedal & Wright, Numerical Optimization, 2nd ed. 2006,
section 18.1), with negative curvature turned round so that it does not stop at an unstable balance.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import least_squares

from labrun.arrays import FloatArray, IntArray
from labrun.errors import ModelError
from labrun.models.chains import dynamics, geometry
from labrun.models.chains.tree import CLOSED, Tree

_STILL = 1e-10
"""Angles are at rest when Newton would move them by no more, rad."""
_MOST_STEPS = 200
_LONGEST_STEP_RAD = 0.2
_DIFFERENCE_RAD = 1e-6
_DEPENDENT = 1e-8
_FEW_STEPS = 12
_EXACT = 1e-13
"""So far apart, rad and m, as good as closed."""


class _Layout:
    """Everything in its place at some angles."""

    def __init__(self, tree: Tree, values: FloatArray, angles: FloatArray) -> None:
        count = len(tree.joints)
        self.tree = tree.array
        self.rotation, self.origin = np.empty((count, 3, 3)), np.empty((count, 3))
        self.axis, self.hinge = np.empty((count, 3)), np.empty((count, 3))
        self.values = values
        geometry.set_poses(self.tree, values, angles, self.rotation, self.origin, self.axis, self.hinge)

    def apart(self) -> FloatArray:
        """Return how far the loop is open, (6,): rotation vector and distance."""
        error = np.zeros(6)
        if self.tree[1] >= 0:
            geometry.apart(self.tree, self.values, self.rotation, self.origin, self.hinge, error)
        return error

    def jacobian(self) -> FloatArray:
        """Return its derivative by the angles, (6, joints)."""
        result = np.zeros((6, len(self.axis)))
        if self.tree[1] >= 0:
            geometry.closing_jacobian(self.tree, self.axis, self.hinge, result)
        return result


def opening(tree: Tree, values: FloatArray, angles: FloatArray) -> FloatArray:
    """Return how far the loop is open: rad, m."""
    error = _Layout(tree, values, np.ascontiguousarray(angles)).apart()
    return np.array([np.linalg.norm(error[:3]), np.linalg.norm(error[3:])])


def turns(tree: Tree, values: FloatArray, angles: FloatArray) -> FloatArray:
    """Return the rotation of every body at every sample, shape (samples, joints, 3, 3)."""
    rows = np.ascontiguousarray(angles, dtype=float)
    return np.array([_Layout(tree, values, row).rotation for row in rows]).reshape(
        len(rows), len(tree.joints), 3, 3
    )


def closed(tree: Tree, values: FloatArray, angles: FloatArray, held: IntArray) -> FloatArray:
    """Return angles near these at which the loop is closed; those of `held` stay.

    Raises ModelError: the loop stays open, or it is not determined where its bodies are.
    """
    apart_now = np.max(opening(tree, values, angles))
    if not np.isfinite(apart_now):
        raise ModelError(
            f"it is not determined where the bodies of model {tree.model} are: an axis, a point or an angle is none",
            hint="look at what [joints] makes of parameters and conditions: an axis needs a direction",
        )
    if tree.first < 0 or apart_now < CLOSED:
        return angles
    moving = np.setdiff1d(np.arange(len(angles)), held)
    solved = angles.copy()
    if moving.size:

        def at(some: FloatArray) -> _Layout:
            solved[moving] = some
            return _Layout(tree, values, solved)

        def apart(some: FloatArray) -> FloatArray:
            return at(some).apart()

        def jacobian(some: FloatArray) -> FloatArray:
            return at(some).jacobian()[:, moving]

        near = _nearest(apart, jacobian, angles[moving])
        if near is None:  # far away: with a trust region
            near = least_squares(
                apart, angles[moving], jacobian, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=_MOST_STEPS
            ).x
        solved[moving] = near
    left = opening(tree, values, solved)
    if np.max(left) < CLOSED:
        return solved
    raise _stays_open(tree, solved, left, held)


def _nearest(
    apart: Callable[[FloatArray], FloatArray],
    jacobian: Callable[[FloatArray], FloatArray],
    angles: FloatArray,
) -> FloatArray | None:
    """Return where shortest Newton steps close a loop that is nearly closed; None where they do not, or are long."""
    here, left = angles, apart(angles)
    for _ in range(_FEW_STEPS):
        step = np.linalg.lstsq(jacobian(here), -left, rcond=_DEPENDENT)[0]
        if np.max(np.abs(step)) > _LONGEST_STEP_RAD:
            return None
        then = apart(here + step)
        if np.linalg.norm(then) >= np.linalg.norm(left):  # as exact as rounding lets it be, or astray
            break
        here, left = here + step, then
    return here if np.max(np.abs(left)) < _EXACT else None


def _stays_open(tree: Tree, angles: FloatArray, left: FloatArray, held: IntArray) -> ModelError:
    joint, body = tree.joints[tree.second], tree.bodies[tree.second]
    where = ", ".join(f"{name} {angle:.4g}" for name, angle in zip(tree.joints, angles, strict=True))
    kept = ", ".join(tree.joints[index] for index in held)
    hint = (
        f"{kept} {'are' if len(held) > 1 else 'is'} held by [initial]; give a rough guess_rad instead, or another value"
        if kept
        else "see whether axes and points of the joints can meet at all, and give a better guess_rad"
    )
    return ModelError(
        f"the loop of model {tree.model} does not close at joint {joint}: the two ends of {body} stay "
        f"{left[0]:.3g} rad and {left[1]:.3g} m apart (angles, rad: {where})",
        hint=hint,
    )


def settled(tree: Tree, values: FloatArray, angles: FloatArray, resting: IntArray) -> FloatArray:
    """Return angles at which springs and weights are in balance, and stay so; joints not in `resting` keep theirs.

    Raises ModelError: there is no such balance near these angles.
    """
    held = np.setdiff1d(np.arange(len(angles)), resting)
    solved = angles.copy()
    for _ in range(_MOST_STEPS):
        jacobian = _Layout(tree, values, solved).jacobian()[:, resting]
        free = null_space(jacobian, rcond=_DEPENDENT)
        push = _push(tree, values, solved)[resting]
        if free.shape[1] == 0:
            return solved
        multipliers = np.asarray(np.linalg.lstsq(jacobian.T, push, rcond=_DEPENDENT)[0], dtype=float)
        curvature = free.T @ _hessian(tree, values, solved, resting, multipliers) @ free
        sizes, directions = np.linalg.eigh(0.5 * (curvature + curvature.T))
        down = directions.T @ (free.T @ push)
        step = free @ directions @ (down / np.maximum(np.abs(sizes), 1e-9 * np.max(np.abs(sizes)) + 1e-300))
        longest = float(np.max(np.abs(step)))
        if longest < _STILL:
            if sizes[0] <= 0:
                break
            return solved
        solved[resting] += step * min(1.0, _LONGEST_STEP_RAD / longest)
        solved = closed(tree, values, solved, held)
    names = ", ".join(tree.joints[index] for index in resting)
    raise ModelError(
        f"model {tree.model} finds no stable rest of {names} from its guess",
        hint='give another guess_rad, or let the joints begin at numbers or at "first"',
    )


def _push(tree: Tree, values: FloatArray, angles: FloatArray) -> FloatArray:
    """Return the torque that springs and weights exert at every joint when nothing moves."""
    count = len(angles)
    layout = _Layout(tree, values, angles)
    push = np.empty(count)
    dynamics.unconstrained(
        layout.tree, values, np.concatenate([angles, np.zeros(count)]), np.zeros(count), layout.rotation, layout.origin,
        layout.axis, layout.hinge, np.empty((count, count)), push, np.zeros(6),
    )  # fmt: skip
    return push


def _hessian(
    tree: Tree, values: FloatArray, angles: FloatArray, resting: IntArray, multipliers: FloatArray
) -> FloatArray:
    """Return the second derivative of energy and constraint, by central differences."""
    columns = []
    for index in resting:
        ends = []
        for sign in (1.0, -1.0):
            moved = angles.copy()
            moved[index] += sign * _DIFFERENCE_RAD
            jacobian = _Layout(tree, values, moved).jacobian()[:, resting]
            ends.append(jacobian.T @ multipliers - _push(tree, values, moved)[resting])
        columns.append((ends[0] - ends[1]) / (2 * _DIFFERENCE_RAD))
    return np.array(columns).T


def moving_together(tree: Tree, values: FloatArray, angles: FloatArray, rates: FloatArray) -> FloatArray:
    """Return the rates nearest to these, in kinetic energy, with which the loop stays closed."""
    if tree.first < 0 or not np.any(rates):
        return rates
    jacobian = _Layout(tree, values, angles).jacobian()
    answer = np.linalg.solve(mass_matrix(tree, values, angles), jacobian.T)
    return np.asarray(
        rates - answer @ np.linalg.lstsq(jacobian @ answer, jacobian @ rates, rcond=_DEPENDENT)[0]
    )


def mass_matrix(tree: Tree, values: FloatArray, angles: FloatArray) -> FloatArray:
    """Return the mass matrix of the tree, (joints, joints), kg m^2."""
    count = len(angles)
    layout, mass = _Layout(tree, values, angles), np.empty((count, count))
    dynamics.unconstrained(
        layout.tree, values, np.concatenate([angles, np.zeros(count)]), np.zeros(count), layout.rotation, layout.origin,
        layout.axis, layout.hinge, mass, np.empty(count), np.zeros(6),
    )  # fmt: skip
    return mass
