"""A gripper of joints that are tied together is held, and the arm that carries it is left to be looked at."""

import mujoco
import numpy as np

from labrun.models import read_robot, robot_terms, with_grip_held

ARM = """
<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.01"/>
<body name="left" pos="0.02 0 -0.4" quat="0.8 0 0.6 0"><joint name="left" axis="0 0 1" pos="0 0.01 0"/>
<inertial pos="0 0 -0.05" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body>
<body name="right" pos="-0.02 0 -0.4"><joint name="right" type="slide" axis="1 0 0"/>
<inertial pos="0 0 -0.05" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>{more}</body></body></worldbody>
<actuator><position name="shoulder" joint="shoulder" kp="10"/><position name="left" joint="left" kp="1"/></actuator>
<equality><joint joint1="right" joint2="left" polycoef="0 0.1 0 0 0"/></equality>
<sensor><jointpos joint="left"/></sensor></mujoco>
"""
WRIST = (
    '<body><joint name="wrist"/><inertial pos="0 0 -0.05" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body>'
)


def robot(tmp_path, more=""):
    (tmp_path / "arm.xml").write_text(ARM.format(more=more))
    return read_robot(tmp_path / "arm.xml")


def test_a_gripper_stands_where_it_is_held_and_the_arm_is_free(tmp_path):
    whole = robot(tmp_path)
    held = with_grip_held(whole, {"left": 0.3, "right": 0.03})
    assert [joint.name for joint in held.joints] == ["shoulder"]
    assert [actuator.name for actuator in held.actuators] == ["shoulder"]
    assert robot_terms(held.xml, ["shoulder"]).coupled == ""
    before, after = (mujoco.MjModel.from_xml_string(exported.xml) for exported in (whole, held))
    data, other = mujoco.MjData(before), mujoco.MjData(after)
    data.qpos[:], other.qpos[:] = (0.7, 0.3, 0.03), 0.7
    mujoco.mj_kinematics(before, data)
    mujoco.mj_kinematics(after, other)
    # MJCF is written with six digits
    np.testing.assert_allclose(other.xipos, data.xipos, atol=1e-6)
    np.testing.assert_allclose(other.ximat, data.ximat, atol=2e-6)


def test_what_is_held_is_said(tmp_path):
    remark = with_grip_held(robot(tmp_path), {}).remarks[-1]
    assert remark == "left, right: tied together, held where the log has them on the average; not looked at"


def test_tied_joints_that_carry_another_are_left_as_they_are(tmp_path):
    whole = robot(tmp_path, WRIST)
    assert with_grip_held(whole, {}) is whole
