"""What joints carry along a motion, against closed forms."""

import numpy as np
import pytest

from labrun.models import carried, robot_terms

LINK_M, MASS, ARMATURE = 0.4, 2.0, 0.03
PENDULUM = f"""
<mujoco><compiler angle="radian"/><worldbody><body name="link">
<joint name="hinge" axis="0 1 0" damping="0.2" armature="{ARMATURE}" stiffness="1.5" springref="0.1"/>
<inertial pos="0 0 -{LINK_M}" mass="{MASS}" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="40" kv="3" forcerange="-9 9"/></actuator></mujoco>
"""
TWO = """
<mujoco><compiler angle="radian"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0"/><inertial pos="0 0 -0.2" mass="1.5" diaginertia="0.01 0.01 0.01"/>
<body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0"/>
<inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.005 0.005 0.005"/></body></body></worldbody></mujoco>
"""
TIME = np.linspace(0, 2, 81)


def motion(joints: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    omega = 2.0 + np.arange(joints)
    size = 0.5 + 0.3 * np.arange(joints)
    angle = np.outer(TIME, omega)
    return size * np.sin(angle), size * omega * np.cos(angle), -size * omega**2 * np.sin(angle)


def test_a_pendulum_carries_its_inertia_and_its_weight():
    q, rate, acceleration = motion(1)
    result = carried(PENDULUM, ["hinge"], (q, rate, acceleration))
    assert result.inertia[:, 0, 0] == pytest.approx(np.full(81, MASS * LINK_M**2 + 1e-3), rel=1e-9)
    weight = MASS * 9.81 * LINK_M
    assert result.torque[:, 0, 0] == pytest.approx(weight * np.sin(q[:, 0]), abs=1e-9)
    assert result.slope[:, 0] == pytest.approx(weight * np.cos(q[:, 0]), abs=1e-5)
    assert result.rate_slope == pytest.approx(np.zeros_like(q), abs=1e-9)


def test_pitch_of_the_base_turns_a_pendulum_and_roll_does_not():
    q, rate, acceleration = motion(1)
    result = carried(PENDULUM, ["hinge"], (q, rate, acceleration))
    assert result.tilt[:, 0, 0] == pytest.approx(np.zeros(81), abs=1e-12)
    # a base pitched by a small angle is a pendulum whose angle is so much larger
    assert result.tilt[:, 0, 1] == pytest.approx(MASS * 9.81 * LINK_M * np.cos(q[:, 0]), rel=1e-6)


def test_a_kilogram_at_the_tip_is_a_point_mass_there():
    q, rate, acceleration = motion(1)
    result = carried(PENDULUM, ["hinge"], (q, rate, acceleration))
    reach = 2 * LINK_M
    expected = reach**2 * acceleration[:, 0] + 9.81 * reach * np.sin(q[:, 0])
    assert result.load[:, 0] == pytest.approx(expected, abs=1e-6)


def test_bodies_add_up_to_the_inverse_dynamics_of_the_robot():
    import mujoco

    q, rate, acceleration = motion(2)
    result = carried(TWO, ["shoulder", "elbow"], (q, rate, acceleration))
    total = (result.torque + result.inertia * acceleration[:, :, None]).sum(axis=2)
    model = mujoco.MjModel.from_xml_string(TWO)
    data = mujoco.MjData(model)
    expected = np.empty_like(q)
    for row in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[row], rate[row], acceleration[row]
        mujoco.mj_inverse(model, data)
        expected[row] = data.qfrc_inverse
    assert total == pytest.approx(expected, abs=1e-9)
    assert result.bodies == ("upper", "lower")


def test_slopes_are_those_of_the_torque():
    q, rate, acceleration = motion(2)
    result = carried(TWO, ["shoulder", "elbow"], (q, rate, acceleration))
    step = 1e-3
    for joint in range(2):
        moved = q.copy()
        moved[:, joint] += step
        there = carried(TWO, ["shoulder", "elbow"], (moved, rate, acceleration))
        change = (there.torque - result.torque)[:, joint].sum(axis=1) / step
        assert change == pytest.approx(result.slope[:, joint], rel=2e-3, abs=2e-2)


def test_a_joint_has_what_the_file_says():
    terms = robot_terms(PENDULUM, ["hinge"])
    assert (terms.damping, terms.stiffness, terms.armature) == ((0.2,), (1.5,), (ARMATURE,))
    assert terms.rest == (0.1,)
    drive = terms.drives["hinge"]
    assert (drive.kp, drive.kv, drive.limits) == (40.0, 3.0, (-9.0, 9.0))
    assert terms.coupled == ""
