"""The regressor of joint torques against MuJoCo's inverse dynamics."""

import mujoco
import numpy as np
import pytest

from labrun.models import InertialRegressor

XML = """
<mujoco><compiler angle="radian"/><worldbody><body name="first" pos=".1 .2 .3" quat=".9 .1 .2 .3">
<joint name="turn" axis="0 .6 .8" pos=".05 0 .02"/><joint name="slide" type="slide" axis="1 0 0"/>
<inertial pos=".1 .02 .3" mass="2" fullinertia=".1 .11 .12 .01 .005 -.01"/>
<body name="fixed" pos="0 0 .1"><inertial pos=".1 .02 .0" mass=".5" diaginertia=".01 .01 .01"/>
<body name="last" pos="0 0 .2" quat=".5 .1 -.2 .3" gravcomp=".5">
<joint name="wrist" axis="1 0 0" pos="0 .1 0" ref=".3"/>
<inertial pos=".0 .02 .2" mass="1" diaginertia=".01 .02 .015"/></body></body></body></worldbody></mujoco>
"""
JOINTS = ["turn", "slide", "wrist"]


@pytest.fixture
def course():
    return np.random.default_rng(0).normal(size=(3, 40, 3))


def mujocos(course, gravity=None):
    model = mujoco.MjModel.from_xml_string(XML)
    model.opt.gravity[:] = model.opt.gravity if gravity is None else gravity
    data, torque = mujoco.MjData(model), []
    for q, rate, acceleration in zip(*course, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, rate, acceleration
        mujoco.mj_inverse(model, data)
        torque.append(data.qfrc_inverse.copy())
    return np.array(torque)


def test_stated_parameters_give_the_torques_of_inverse_dynamics(course):
    regressor = InertialRegressor(XML, JOINTS)
    motion = regressor.motion(*course)
    torque = [
        regressor.columns(motion, joint).reshape(40, -1) @ regressor.stated.ravel() for joint in range(3)
    ]
    assert np.column_stack(torque) == pytest.approx(mujocos(course), abs=1e-9)
    assert regressor.torque(motion, 3) == pytest.approx(mujocos(course), abs=1e-9)


def test_a_tilt_turns_gravity_the_other_way(course):
    regressor = InertialRegressor(XML, JOINTS)
    motion = regressor.motion(*course)
    small = 1e-6
    for axis, turned in enumerate(([0.0, -small, -1.0], [small, 0.0, -1.0])):
        change = (mujocos(course, 9.81 * np.array(turned)) - mujocos(course)) / small
        tilt = np.column_stack([regressor.tilt(motion, joint)[:, axis] for joint in range(3)])
        assert np.abs(np.corrcoef(tilt.ravel(), change.ravel())[0, 1]) == pytest.approx(1.0, abs=1e-6)


def test_the_joint_before_is_the_one_that_carries_it():
    assert InertialRegressor(XML, JOINTS).before == (-1, 0, 1)
