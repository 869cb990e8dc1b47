"""The joint torques of a moving robot as a linear function of the inertial parameters of its links."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.models.mjcf.inverse import tip_body
from labrun.models.mjcf.plant import imported

INERTIAL = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""Standard inertial parameters of a link in its own frame: mass (kg), first moment (kg m), inertia about the frame's
origin (kg m^2)."""


@dataclass(frozen=True)
class LinkMotion:
    """How the links move along a measured motion of the joints; n samples.

    Attributes
    ----------
    rate, acceleration : per body (n, 3)
        Angular rate and angular acceleration in the body's frame.
    fall : per body (n, 3)
        Acceleration of the body's origin less gravity, in the body's frame.
    tilt : per body (n, 3, 2)
        Change of `fall` per rad that the base is rolled (about x) and pitched (about y).
    arms : per body, per joint (n, 6)
        Torque (force) of the joint for each unit of the moment about the body's origin and of the force on the body, in
        the body's frame; only joints that carry the body.
    """

    rate: tuple[FloatArray, ...]
    acceleration: tuple[FloatArray, ...]
    fall: tuple[FloatArray, ...]
    tilt: tuple[FloatArray, ...]
    arms: tuple[dict[int, FloatArray], ...]


class InertialRegressor:
    """The matrix Y of ``torque = Y(q, q', q'') parameters`` for rigid links.

    Parameters
    ----------
    xml
        MJCF without other files.
    joints
        Names of its hinges and slides, in the order of the columns of a motion; all others stay where they begin.

    Attributes
    ----------
    bodies
        Names of the bodies with a mass that the joints move.
    stated : (bodies, 10)
        Their parameters as the file states them, in the order of `INERTIAL`.
    masses : (bodies,)
    radii : (bodies,)
        A length typical of each body: its radius of gyration about the origin of its frame, m.
    before : per joint
        Place of the joint that carries each joint; -1 where there is none.
    tip
        Place of the last body of the first chain among `bodies`; -1 if there is none.

    Notes
    -----
    Khalil and Dombre, Modeling, Identification and Control of Robots (2002), chapters 9 and 12; Featherstone, Rigid
    Body Dynamics Algorithms (2008), chapter 5.
    """

    def __init__(self, xml: str, joints: list[str]) -> None:
        mujoco = imported()
        model = mujoco.MjModel.from_xml_string(xml)
        self._model = model
        self._columns = {int(model.joint(name).id): column for column, name in enumerate(joints)}
        self._hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
        self._heavy = [
            body
            for body in range(1, model.nbody)
            if model.body_mass[body] > 0 and model.body_weldid[body] != 0
        ]
        self.bodies = tuple(
            mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or f"body{body}" for body in self._heavy
        )
        self.stated = np.array([_stated(model, body) for body in self._heavy]).reshape(-1, 10)
        self.masses = self.stated[:, 0]
        self.radii = np.sqrt(self.stated[:, [4, 7, 9]].sum(axis=1) / (2.0 * self.masses))
        self.before = tuple(self._carrier(int(model.joint(name).id)) for name in joints)
        last = tip_body(model)
        self.tip = self._heavy.index(last) if last in self._heavy else -1

    def _carrier(self, joint: int) -> int:
        model = self._model
        body = int(model.jnt_bodyid[joint])
        known = [other for other in self._columns if other < joint and int(model.jnt_bodyid[other]) == body]
        while not known and body:
            body = int(model.body_parentid[body])
            known = [other for other in self._columns if int(model.jnt_bodyid[other]) == body]
        return self._columns[max(known)] if known else -1

    def motion(self, q: FloatArray, rate: FloatArray, acceleration: FloatArray) -> LinkMotion:
        """Return how the links move; coordinates, rates and accelerations of the joints are (n, joints), SI."""
        model, count = self._model, len(q)
        zero = np.zeros((count, 3))
        gravity = np.array(model.opt.gravity)
        turn: list[FloatArray] = [np.tile(np.eye(3), (count, 1, 1))]
        origin, spin, spin_rate, moved = [zero], [zero], [zero], [zero]
        carriers: list[dict[int, tuple[FloatArray, FloatArray, bool]]] = [{}]
        for body in range(1, model.nbody):
            parent = int(model.body_parentid[body])
            to_parent = turn[parent]
            w, dw = spin[parent], spin_rate[parent]
            offset = to_parent @ np.array(model.body_pos[body])
            here = origin[parent] + offset
            a = moved[parent] + _cross(dw, offset) + _cross(w, _cross(w, offset))
            rotation = to_parent @ _matrix(np.array(model.body_quat[body]))
            carried = dict(carriers[parent])
            for joint in range(
                int(model.body_jntadr[body]), int(model.body_jntadr[body] + model.body_jntnum[body])
            ):
                column = self._columns.get(joint)
                if column is None:
                    continue
                axis_here = np.array(model.jnt_axis[joint])
                axis = rotation @ axis_here
                anchor = here + rotation @ np.array(model.jnt_pos[joint])
                by = q[:, column] - model.qpos0[model.jnt_qposadr[joint]]
                v, dv = rate[:, [column]], acceleration[:, [column]]
                hinge = bool(model.jnt_type[joint] == self._hinge)
                if hinge:
                    arm = here - anchor
                    a = a - _cross(dw, arm) - _cross(w, _cross(w, arm))
                    dw = dw + axis * dv + _cross(w, axis) * v
                    w = w + axis * v
                    rotation = rotation @ _turns(axis_here, by)
                    here = anchor - rotation @ np.array(model.jnt_pos[joint])
                    arm = here - anchor
                    a = a + _cross(dw, arm) + _cross(w, _cross(w, arm))
                else:
                    way = axis * by[:, None]
                    a = a + _cross(dw, way) + _cross(w, _cross(w, way))
                    a = a + 2.0 * _cross(w, axis) * v + axis * dv
                    here = here + way
                carried[column] = (axis, anchor, hinge)
            turn.append(rotation)
            origin.append(here)
            spin.append(w)
            spin_rate.append(dw)
            moved.append(a)
            carriers.append(carried)
        tilts = np.column_stack([np.cross(axis, gravity) for axis in np.eye(3)[:2]])
        inwards = [np.swapaxes(turn[body], 1, 2) for body in self._heavy]
        compensated = [1.0 - float(model.body_gravcomp[body]) for body in self._heavy]
        return LinkMotion(
            tuple(_along(back, spin[body]) for back, body in zip(inwards, self._heavy, strict=True)),
            tuple(_along(back, spin_rate[body]) for back, body in zip(inwards, self._heavy, strict=True)),
            tuple(
                _along(back, moved[body] - part * gravity)
                for back, body, part in zip(inwards, self._heavy, compensated, strict=True)
            ),
            tuple(part * (back @ tilts) for back, part in zip(inwards, compensated, strict=True)),
            tuple(
                {
                    column: _arm(back, axis, origin[body] - anchor, hinge=hinge)
                    for column, (axis, anchor, hinge) in carriers[body].items()
                }
                for back, body in zip(inwards, self._heavy, strict=True)
            ),
        )

    def columns(self, motion: LinkMotion, joint: int) -> FloatArray:
        """Return the rows of Y that belong to a joint, shape (n, bodies, 10)."""
        parts = []
        for body in range(len(self.bodies)):
            arm = motion.arms[body].get(joint)
            count = len(motion.fall[body])
            if arm is None:
                parts.append(np.zeros((count, 10)))
                continue
            parts.append(_projected(motion.rate[body], motion.acceleration[body], motion.fall[body], arm))
        return np.stack(parts, axis=1)

    def torque(self, motion: LinkMotion, joints: int) -> FloatArray:
        """Return what the links as stated ask of the joints, (n, joints)."""
        torque = np.zeros((len(motion.fall[0]), joints))
        for body, parameters in enumerate(self.stated):
            rate, acceleration, fall = motion.rate[body], motion.acceleration[body], motion.fall[body]
            mass, first = parameters[0], parameters[1:4]
            inertia = np.empty((3, 3))
            inertia[np.triu_indices(3)] = parameters[4:]
            inertia = np.triu(inertia) + np.triu(inertia, 1).T
            force = mass * fall + _cross(acceleration, first) + _cross(rate, _cross(rate, first))
            moment = acceleration @ inertia + _cross(rate, rate @ inertia) + _cross(first, fall)
            wrench = np.concatenate([moment, force], axis=1)
            for joint, arm in motion.arms[body].items():
                torque[:, joint] += np.einsum("ni,ni->n", arm, wrench)
        return torque

    def tilt(self, motion: LinkMotion, joint: int) -> FloatArray:
        """Return what the links as stated ask more of a joint per rad of roll and of pitch of the base, (n, 2)."""
        count = len(motion.fall[0])
        torque = np.zeros((count, 2))
        still = np.zeros((count, 3))
        for body in range(len(self.bodies)):
            arm = motion.arms[body].get(joint)
            if arm is None:
                continue
            for axis in range(2):
                rows = _projected(still, still, motion.tilt[body][:, :, axis], arm)
                torque[:, axis] += rows @ self.stated[body]
        return torque


def _stated(model: Any, body: int) -> FloatArray:
    mass, centre = float(model.body_mass[body]), np.array(model.body_ipos[body])
    axes = _matrix(np.array(model.body_iquat[body]))
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    inertia = inertia + mass * (float(centre @ centre) * np.eye(3) - np.outer(centre, centre))
    upper = np.triu_indices(3)
    return np.concatenate([[mass], mass * centre, inertia[upper]])


def _matrix(quaternion: FloatArray) -> FloatArray:
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _turns(axis: FloatArray, angles: FloatArray) -> FloatArray:
    """Return the rotations about a fixed axis by each angle (Rodrigues), shape (n, 3, 3)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    rotations: FloatArray = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return rotations


def _along(rotations: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", rotations, vectors))


def _arm(inwards: FloatArray, axis: FloatArray, arm: FloatArray, *, hinge: bool) -> FloatArray:
    own = _along(inwards, axis)
    if not hinge:
        return np.concatenate([np.zeros_like(own), own], axis=1)
    return np.concatenate([own, _cross(own, _along(inwards, arm))], axis=1)


def _projected(rate: FloatArray, acceleration: FloatArray, fall: FloatArray, arm: FloatArray) -> FloatArray:
    """Return what each inertial parameter of a body asks of a joint, by Newton and Euler, (n, 10)."""
    moment, force = arm[:, :3], arm[:, 3:]
    # force on the body: m fall + (acceleration x h) + rate x (rate x h), with the first moment h
    turned = _cross_matrix(acceleration) + _cross_matrix(rate) @ _cross_matrix(rate)
    by_mass = np.einsum("ni,ni->n", force, fall)
    # moment about the origin: h x fall, so that moment . (h x fall) = h . (fall x moment)
    by_first = np.einsum("ni,nij->nj", force, turned) + _cross(fall, moment)
    # I acceleration + rate x (I rate); moment . (rate x (I rate)) = (moment x rate) . (I rate)
    across = _cross(moment, rate)
    outer = moment[:, :, None] * acceleration[:, None, :] + across[:, :, None] * rate[:, None, :]
    by_inertia = np.stack(
        [
            outer[:, 0, 0], outer[:, 0, 1] + outer[:, 1, 0], outer[:, 0, 2] + outer[:, 2, 0],
            outer[:, 1, 1], outer[:, 1, 2] + outer[:, 2, 1], outer[:, 2, 2],
        ],
        axis=1,
    )  # fmt: skip
    return np.concatenate([by_mass[:, None], by_first, by_inertia], axis=1)


def _cross(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return cross products along the last axis; `numpy.cross` takes several times as long."""
    a, b, c = left[..., 0], left[..., 1], left[..., 2]
    x, y, z = right[..., 0], right[..., 1], right[..., 2]
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def _cross_matrix(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)
