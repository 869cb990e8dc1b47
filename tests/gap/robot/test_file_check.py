"""What of a correction is written: only what is better where the fit has not seen the log."""

import mujoco
import numpy as np
import pytest

from labrun.fit import Dataset, FitTrial
from labrun.gap import check_file
from labrun.models import load_model, mjcf_of, read_robot, robot_table
from labrun.store import SignalInfo

XML = """
<mujoco model="arm"><compiler angle="radian"/><option timestep="0.001"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" damping="0.4" armature="0.05"/>
<inertial pos="0 0 -0.2" mass="1.5" diaginertia="0.01 0.01 0.01"/>
<body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0" damping="0.2" armature="0.02"/>
<inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.005 0.005 0.005"/></body></body></worldbody>
<actuator><position name="shoulder" joint="shoulder" kp="150" kv="8"/>
<position name="elbow" joint="elbow" kp="40" kv="2"/></actuator></mujoco>
"""
NOISE_RAD = 2e-4
FRICTION = {
    "effect": "coulomb-friction", "kind": "joint", "site": "elbow", "values": [0.4, 5e-4, 0.0],
}  # fmt: skip
MOVED = {"shoulder_kp": 105.0, "upper_mass_ratio": 1.13, "lower_mass_ratio": 0.9}
"""What a recalibration that imitates something says of a joint that moves as its file says."""


def logged(folder, friction, armature=0.0):
    """Return the robot, its model, and six motions that MuJoCo makes with dry friction at the elbow."""
    (folder / "arm.xml").write_text(XML)
    robot = read_robot(folder / "arm.xml")
    (folder / "model.toml").write_text(robot_table(robot))
    spec = mujoco.MjSpec.from_string(XML)
    spec.joint("elbow").frictionloss = friction
    spec.joint("elbow").armature += armature
    spec.option.timestep = 2.5e-4
    native, rng = spec.compile(), np.random.default_rng(4)
    time_s, trials = np.arange(0.0, 1.5, 0.01), []
    for number in range(5):
        frequency, phase = rng.uniform(0.4, 1.6, 2), rng.uniform(0.0, 6.0, 2)
        goals = (
            np.sin(np.pi * time_s / 1.5)[:, None]
            * 0.5
            * np.sin(2 * np.pi * time_s[:, None] * frequency + phase)
        )
        data, angles = mujoco.MjData(native), []
        for goal in goals:
            angles.append(data.qpos + NOISE_RAD * rng.standard_normal(2))
            data.ctrl[:] = goal
            mujoco.mj_step(native, data, nstep=40)
        trials.append(FitTrial(f"{number}", {"motion": f"{number}"}, 1, time_s, goals, np.array(angles)))
    inputs = tuple(SignalInfo(name, "rad", between="hold") for name in ("shoulder_command", "elbow_command"))
    outputs = tuple(SignalInfo(name, "rad") for name in ("shoulder", "elbow"))
    dataset = Dataset("arm", folder, "recording", inputs, outputs, tuple(trials))
    return robot, load_model(folder / "model.toml"), dataset


def diagnosis(shoulder, elbow, effects=(), causes=()):
    """Return a stored diagnosis with what two joints are said to be."""
    joints = [
        {"joint": "shoulder", "diagnosis": {"corrected": shoulder, "effects": [], "causes": []}},
        {
            "joint": "elbow",
            "diagnosis": {"corrected": elbow, "effects": list(effects), "causes": list(causes)},
        },
    ]
    return {"joints": joints, "whole": [], "corrected": {}, "effects": list(effects), "seed": 0}


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    robot, model, dataset = logged(tmp_path_factory.mktemp("arm"), 0.4)
    return model, check_file(robot, model, dataset, diagnosis(MOVED, {}, [FRICTION]))


def test_a_cause_that_is_there_is_written_and_the_file_simulates_unseen_motions_better(checked):
    _, check = checked
    elbow = check.joints[1]
    assert elbow.exported_as == "causes"
    assert "causes" in elbow.corrected_as
    assert elbow.exported < 0.2 * elbow.stated
    assert elbow.corrected < 0.2 * elbow.stated
    assert [effect.effect.id for effect in check.file.effects] == ["coulomb-friction"]


def test_parameters_of_a_joint_that_moves_as_stated_stay_as_stated(checked):
    model, check = checked
    shoulder = check.joints[0]
    assert shoulder.exported_as == shoulder.corrected_as == "as stated"
    assert check.file.values == {}
    assert not {"shoulder_kp", "upper_mass"} & set(check.model.values)
    exported = mjcf_of(model.with_values(check.file.values).with_effects(check.file.effects))
    native = mujoco.MjModel.from_xml_string(exported.xml)
    assert native.actuator("shoulder").gainprm[0] == 150.0
    assert native.joint("elbow").frictionloss[0] == pytest.approx(0.4, rel=0.1)


def test_a_cause_that_is_not_there_is_left_out(tmp_path):
    robot, model, dataset = logged(tmp_path, 0.0)
    check = check_file(robot, model, dataset, diagnosis({}, {}, [FRICTION]))
    assert [joint.exported_as for joint in check.joints] == ["as stated", "as stated"]
    assert check.file.effects == ()
    assert check.file.of_the_whole == ()
    for joint in check.joints:
        assert joint.exported == joint.stated


def test_a_parameter_that_is_the_cause_moves_further_than_its_tolerance(tmp_path):
    robot, model, dataset = logged(tmp_path, 0.0, 0.03)
    cause = {"effect": "elbow_armature", "kind": "parameter", "site": "elbow_armature"}
    check = check_file(robot, model, dataset, diagnosis({}, {"elbow_armature": 0.05}, causes=[cause]))
    assert check.joints[1].exported_as == "causes"
    assert check.file.values["elbow_armature"] == pytest.approx(0.05, rel=0.05)


def test_a_check_reads_what_it_stored(checked):
    _, check = checked
    assert type(check).from_json(check.to_json()) == check
