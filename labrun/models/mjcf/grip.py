"""Fix a gripper with coupled joints in place, so that the arm can be diagnosed joint by joint."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from labrun.models.mjcf.plant import imported
from labrun.models.mjcf.robot import Robot, mjcf_text


def with_grip_held(robot: Robot, at: Mapping[str, float]) -> Robot:
    """Return a robot in which joints that are tied to one another, and carry no other joint, do not move.

    Such are the fingers of a gripper: one mimics the other, by an equality constraint or a tendon. They are light, and
    whether they are open or closed hardly moves the rest. A robot that is tied otherwise comes back as it is.

    Parameters
    ----------
    at : joint -> position
        Where tied joints are held, rad or m; where the file has them if not given.
    """
    mujoco = imported()
    spec = mujoco.MjSpec.from_string(robot.xml)
    model = spec.compile()
    tied = _tied(mujoco, model)
    if not tied or _carries_others(model, tied):
        return robot
    names = [str(model.joint(index).name) for index in sorted(tied)]
    data = mujoco.MjData(model)
    for name in names:
        data.qpos[model.joint(name).qposadr[0]] = at.get(name, float(model.joint(name).qpos0[0]))
    mujoco.mj_kinematics(model, data)
    for number in {int(model.jnt_bodyid[index]) for index in tied}:
        body, parent = spec.bodies[number], int(model.body_parentid[number])
        back = np.empty(4)
        mujoco.mju_negQuat(back, data.xquat[parent])
        position, turn = np.empty(3), np.empty(4)
        mujoco.mju_rotVecQuat(position, data.xpos[number] - data.xpos[parent], back)
        mujoco.mju_mulQuat(turn, back, data.xquat[number])
        body.pos, body.quat = position, turn
    gone = {*names, *(tendon.name for tendon in spec.tendons)}
    for listed in (spec.equalities, spec.tendons, spec.keys):
        for entry in list(listed):
            spec.delete(entry)
    for entry in [sensor for sensor in spec.sensors if sensor.objname in gone]:
        spec.delete(entry)
    for actuator in [actuator for actuator in spec.actuators if actuator.target in gone]:
        spec.delete(actuator)
    for name in names:
        spec.delete(spec.joint(name))
    spec.compile()
    left = {actuator.name for actuator in spec.actuators}
    remark = f"{', '.join(names)}: tied together, held where the log has them on the average; not looked at"
    return replace(
        robot,
        xml=mjcf_text(spec),
        joints=tuple(joint for joint in robot.joints if joint.name not in names),
        actuators=tuple(actuator for actuator in robot.actuators if actuator.name in left),
        remarks=(*robot.remarks, remark),
    )


def _tied(mujoco: Any, model: Any) -> set[int]:
    """Return the joints that equality constraints and tendons tie together; none if these tie anything else."""
    simple = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
    if np.any(model.eq_type != int(mujoco.mjtEq.mjEQ_JOINT)):
        return set()
    if np.any(model.wrap_type != int(mujoco.mjtWrap.mjWRAP_JOINT)):
        return set()
    tied = {int(index) for index in (*model.eq_obj1id, *model.eq_obj2id, *model.wrap_objid) if index >= 0}
    return tied if all(model.jnt_type[index] in simple for index in tied) else set()


def _carries_others(model: Any, tied: set[int]) -> bool:
    """Tell whether a joint that is not tied stands on a body that a tied one moves, or further out."""
    moved = {int(model.jnt_bodyid[index]) for index in tied}
    for joint in set(range(model.njnt)) - tied:
        body = int(model.jnt_bodyid[joint])
        while body:
            if body in moved:
                return True
            body = int(model.body_parentid[body])
    return False
