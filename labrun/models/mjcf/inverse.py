"""What each joint of a moving robot has to carry: inertia and torque, body by body, from its measured motion."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.models.mjcf.plant import imported

_TURN = 1e-4
"""Half the difference of coordinates (rad, m) and of rates behind a slope."""


@dataclass(frozen=True)
class Carried:
    """What the joints carry along a motion, without what their own springs, dampers and drives do.

    Attributes
    ----------
    bodies
        Names of the bodies with a mass, each with what it alone asks of the joints.
    inertia : (n, joints, bodies)
        Own inertia at each joint, kg m^2 (kg).
    torque : (n, joints, bodies)
        What the joint must exert for gravity, rates and the accelerations of all other joints, N m (N).
    slope, rate_slope : (n, joints)
        How the torque of all bodies grows with the joint's own coordinate and rate.
    tilt : (n, joints, 2)
        What gravity asks for more for each rad that the base is rolled (about x) and pitched (about y).
    load : (n, joints)
        What a kilogram at the far end of the last body would ask for, own acceleration included.
    gravity : (n, joints)
        What holds each joint against gravity.
    """

    bodies: tuple[str, ...]
    inertia: FloatArray
    torque: FloatArray
    slope: FloatArray
    rate_slope: FloatArray
    tilt: FloatArray
    load: FloatArray
    gravity: FloatArray


def carried(xml: str, joints: list[str], motion: tuple[FloatArray, FloatArray, FloatArray]) -> Carried:
    """Return what the joints of a robot carry along a measured motion, by the recursive Newton-Euler equations.

    Parameters
    ----------
    xml
        MJCF without other files.
    joints
        Names of its hinges and slides, in the order of the columns of `motion`; all others stay where they begin.
    motion : (n, joints) each
        Coordinates, rates and accelerations, SI.

    Notes
    -----
    Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 5; MuJoCo's ``mj_rne`` and ``mj_crb``.
    """
    mujoco = imported()
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    positions = np.array([model.joint(name).qposadr[0] for name in joints])
    dofs = np.array([model.joint(name).dofadr[0] for name in joints])
    model.dof_armature[:] = 0.0
    masses, inertias = model.body_mass.copy(), model.body_inertia.copy()
    heavy = [k for k in range(1, model.nbody) if masses[k] > 0 and _moved(model, k)]
    names = tuple(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, k) or f"body{k}" for k in heavy)
    dynamics_pass = _Pass(mujoco, model, data, positions, dofs, motion)
    inertia, torque = [], []
    for body in heavy:
        model.body_mass[:], model.body_inertia[:] = 0.0, 0.0
        model.body_mass[body], model.body_inertia[body] = masses[body], inertias[body]
        full, own = dynamics_pass.torque(), dynamics_pass.inertia()
        inertia.append(own)
        torque.append(full - own * motion[2])
    model.body_mass[:], model.body_inertia[:] = masses, inertias
    slope, rate_slope = dynamics_pass.slopes()
    gravity = model.opt.gravity.copy()
    tilt = []
    still = dynamics_pass.torque(gravity_only=True)
    for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        # the base turns one way, gravity in it the other
        model.opt.gravity[:] = gravity - np.cross(axis, gravity)
        tilt.append(dynamics_pass.torque(gravity_only=True) - still)
    model.opt.gravity[:] = gravity
    tip = TipLoad(xml, joints, motion)
    return Carried(
        names,
        np.stack(inertia, 2),
        np.stack(torque, 2),
        slope,
        rate_slope,
        np.stack(tilt, 2),
        tip.torque(tip.far_end),
        still,
    )


def _moved(model: Any, body: int) -> bool:
    return bool(model.body_weldid[body] != 0)


def tip_body(model: Any) -> int:
    """Return the last body with a mass of a robot's first chain; 0 if there is none that moves."""
    heavy = [k for k in range(1, model.nbody) if model.body_mass[k] > 0 and _moved(model, k)]
    if not heavy:
        return 0
    chain = [body for body in heavy if model.body_rootid[body] == model.body_rootid[heavy[0]]]
    return max(chain, key=lambda body: _depth(model, body))


def far_end(model: Any) -> FloatArray:
    """Return where the last body ends, m in its frame: its centre, seen once more from its joint."""
    return 2.0 * np.array(model.body_ipos[tip_body(model)])


class TipLoad:
    """A kilogram on the last body of a robot that moves as measured.

    Parameters
    ----------
    xml, joints, motion
        As `carried` takes them.
    """

    def __init__(
        self, xml: str, joints: list[str], motion: tuple[FloatArray, FloatArray, FloatArray]
    ) -> None:
        mujoco = imported()
        model = mujoco.MjModel.from_xml_string(xml)
        self.far_end = far_end(model)
        """Where the body ends, m in its frame."""
        self._body = tip_body(model)
        self.body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, self._body) or ""
        """Its name; "" if it has none."""
        positions = np.array([model.joint(name).qposadr[0] for name in joints])
        dofs = np.array([model.joint(name).dofadr[0] for name in joints])
        model.dof_armature[:] = 0.0
        self._model = model
        self._pass = _Pass(mujoco, model, mujoco.MjData(model), positions, dofs, motion)

    def torque(self, place_m: FloatArray) -> FloatArray:
        """Return the joint torques per kg of payload, inertial ones included: N m (N) per kg, shape (n, joints).

        Parameters
        ----------
        place_m : (3,)
            Of the point, in the body's frame.
        """
        model, last = self._model, self._body
        if not last:
            return np.zeros_like(self._pass.motion[0])
        model.body_mass[:], model.body_inertia[:] = 0.0, 0.0
        model.body_mass[last], model.body_inertia[last] = 1.0, 1e-9
        model.body_ipos[last], model.body_sameframe[last], model.body_simple[last] = place_m, 0, 0
        return self._pass.torque()


def _depth(model: Any, body: int) -> int:
    count = 0
    while body:
        body, count = int(model.body_parentid[body]), count + 1
    return count


@dataclass(frozen=True)
class _Pass:
    """The equations once along the motion, for whatever masses and gravity the model has now."""

    mujoco: Any
    model: Any
    data: Any
    positions: Any
    dofs: Any
    motion: tuple[FloatArray, FloatArray, FloatArray]

    def torque(self, *, gravity_only: bool = False) -> FloatArray:
        torque = np.empty_like(self.motion[0])
        result = np.empty(self.model.nv)
        data = self.data
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        for row in range(len(torque)):
            data.qpos[self.positions] = self.motion[0][row]
            if not gravity_only:
                data.qvel[self.dofs] = self.motion[1][row]
                data.qacc[self.dofs] = self.motion[2][row]
            self._place()
            self.mujoco.mj_comVel(self.model, data)
            self.mujoco.mj_rne(self.model, data, 1, result)
            torque[row] = result[self.dofs]
        return torque

    def inertia(self) -> FloatArray:
        inertia = np.empty_like(self.motion[0])
        full = np.empty((self.model.nv, self.model.nv))
        old = hasattr(self.data, "qM")
        for row in range(len(inertia)):
            self.data.qpos[self.positions] = self.motion[0][row]
            self._place()
            self.mujoco.mj_makeM(self.model, self.data) if hasattr(
                self.mujoco, "mj_makeM"
            ) else self.mujoco.mj_crb(self.model, self.data)
            if old:
                self.mujoco.mj_fullM(self.model, full, self.data.qM)
            else:
                self.mujoco.mj_fullM(self.model, self.data, full)
            inertia[row] = np.diag(full)[self.dofs]
        return inertia

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        by_place, by_rate = np.empty_like(self.motion[0]), np.empty_like(self.motion[0])
        mujoco, model, data = self.mujoco, self.model, self.data
        ends = np.empty((2, model.nv))
        for row in range(len(by_place)):
            q, rate = self.motion[0][row], self.motion[1][row]
            data.qvel[self.dofs], data.qacc[self.dofs] = rate, self.motion[2][row]
            for k, (position, dof) in enumerate(zip(self.positions, self.dofs, strict=True)):
                data.qpos[self.positions] = q
                for end, sign in enumerate((-1.0, 1.0)):
                    data.qpos[position] = q[k] + sign * _TURN
                    self._place()
                    mujoco.mj_comVel(model, data)
                    mujoco.mj_rne(model, data, 1, ends[end])
                by_place[row, k] = (ends[1, dof] - ends[0, dof]) / (2 * _TURN)
            data.qpos[self.positions] = q
            self._place()
            for k, dof in enumerate(self.dofs):
                for end, sign in enumerate((-1.0, 1.0)):
                    data.qvel[dof] = rate[k] + sign * _TURN
                    mujoco.mj_comVel(model, data)
                    mujoco.mj_rne(model, data, 1, ends[end])
                data.qvel[dof] = rate[k]
                by_rate[row, k] = (ends[1, dof] - ends[0, dof]) / (2 * _TURN)
        return by_place, by_rate

    def _place(self) -> None:
        self.mujoco.mj_kinematics(self.model, self.data)
        self.mujoco.mj_comPos(self.model, self.data)


@dataclass(frozen=True)
class JointDrive:
    """The drive of one joint: ``clip(kp (goal - q) - kv q')``, ``kp (goal - q')``, or ``gear u``.

    Attributes
    ----------
    limits
        Of its torque (force); infinite where the file gives none.
    """

    kp: float
    kv: float
    gear: float
    limits: tuple[float, float]


@dataclass(frozen=True)
class RobotTerms:
    """Parameters of each joint as the file states, SI, in the order of the requested joints.

    Attributes
    ----------
    rest
        Where its spring pulls to.
    coupled
        What ties joints together beside their bodies, in a sentence; "" if nothing.
    step_s
        The time step that the file is simulated with.
    """

    damping: tuple[float, ...]
    stiffness: tuple[float, ...]
    armature: tuple[float, ...]
    friction: tuple[float, ...]
    rest: tuple[float, ...]
    drives: dict[str, JointDrive]
    coupled: str
    step_s: float


def robot_terms(xml: str, joints: list[str]) -> RobotTerms:
    """Return the parameters of each joint of a robot."""
    mujoco = imported()
    model = mujoco.MjModel.from_xml_string(xml)
    dofs = [int(model.joint(name).dofadr[0]) for name in joints]
    numbers = [int(model.joint(name).id) for name in joints]

    def of(values: Any, rows: list[int]) -> tuple[float, ...]:
        return tuple(float(np.ravel(values[row])[0]) for row in rows)

    drives = {}
    for k in range(model.nu):
        if model.actuator_trntype[k] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        joint = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, int(model.actuator_trnid[k, 0])) or ""
        gear = float(model.actuator_gear[k, 0])
        low, high = (
            (float(limit) * abs(gear) for limit in model.actuator_forcerange[k])
            if model.actuator_forcelimited[k]
            else (-np.inf, np.inf)
        )
        gain, bias = model.actuator_gainprm[k], model.actuator_biasprm[k]
        servo = model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
        kp = float(gain[0]) * gear**2 if servo else 0.0
        drives[joint] = JointDrive(
            kp, -float(bias[2]) * gear**2 if servo else 0.0, gear * float(gain[0]), (low, high)
        )
    coupled = ""
    if model.neq:
        coupled = "equality constraints tie its joints together"
    elif model.ntendon:
        coupled = "tendons tie its joints together"
    elif set(range(model.nv)) - set(dofs):
        coupled = "it has ball or free joints"
    return RobotTerms(
        of(model.dof_damping, dofs), of(model.jnt_stiffness, numbers), of(model.dof_armature, dofs),
        of(model.dof_frictionloss, dofs), of(model.qpos_spring, [int(model.joint(n).qposadr[0]) for n in joints]),
        drives, coupled, float(model.opt.timestep),
    )  # fmt: skip
