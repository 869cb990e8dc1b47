"""``scene = "arm.xml"``: the file is the bench, and what it feels is what statics say."""

import numpy as np
import pytest

from labrun import registry
from labrun.devices import Trajectory
from labrun.errors import SpecError
from labrun.experiment import load_experiment, new_experiment

ARM = """
<mujoco model="arm"><worldbody><body name="upper"><joint name="joint_1" axis="0 1 0" damping="2"/>
<inertial pos="0 0 -.1" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/><site name="s"/>
<body name="arm" pos="0 0 -.2"><joint name="joint_2" axis="0 1 0" damping="2"/>
<inertial pos="0 0 -.1" mass="0.2" diaginertia="5e-4 5e-4 5e-4"/></body></body></worldbody>
<actuator><position joint="joint_1" kp="20"/></actuator><sensor><force name="f" site="s"/></sensor></mujoco>
"""


def bench(**settings):
    return registry.load("labrun.scenes", "robot")({"model": ARM, **settings}, np.random.default_rng(0))


def held_at(scene, angle_rad, after_s=5.0):
    command = Trajectory(("joint_1",), np.array([0.0, 1.0]), np.array([[0.0], [angle_rad]]), None)
    scene.drive("joint_1", command, 0.0)
    return dict(
        zip(scene.signals, scene.observe(tuple(scene.signals), np.array([0.0, after_s]))[-1], strict=True)
    )


def test_the_sensor_feels_the_weight_and_the_servo_sags_under_it():
    felt = held_at(bench(), 0.5)
    angle = felt["joint_1"]
    weight = 9.81 * (0.3 + 0.2)
    assert np.hypot(felt["force_x"], felt["force_z"]) == pytest.approx(weight, rel=1e-4)
    # the servo added at joint_2 holds it near zero: both bodies turn about the first joint
    torque = 9.81 * np.sin(angle) * (0.3 * 0.1 + 0.2 * 0.2) + 9.81 * 0.2 * 0.1 * np.sin(
        angle + felt["joint_2"]
    )
    assert 20 * (0.5 - angle) == pytest.approx(torque, rel=1e-3)


def test_a_body_is_seen_where_it_is():
    seen = held_at(bench(), 0.5)
    angle = seen["joint_1"]
    assert [seen["arm_x"], seen["arm_z"]] == pytest.approx(
        [-0.2 * np.sin(angle), -0.2 * np.cos(angle)], abs=1e-9
    )
    assert seen["upper_qw"] == pytest.approx(np.cos(angle / 2))


def test_a_hidden_effect_is_there_and_truth_tells_it():
    hidden = [{"effect": "coulomb-friction", "site": "joint_1", "values": {"torque": 1.0}}]
    stuck = bench(hide=hidden)
    assert abs(held_at(stuck, 0.02, after_s=1.5)["joint_1"]) < 0.7 * abs(
        held_at(bench(), 0.02, after_s=1.5)["joint_1"]
    )
    assert stuck.truth()["hidden"][0]["effect"] == "coulomb-friction"


def test_a_restored_bench_goes_on_to_the_same_last_bit():
    first, other = bench(), bench()
    held_at(first, 0.3, after_s=0.5)
    other.restore(first.snapshot())
    times = np.linspace(0.51, 0.8, 5)
    assert np.array_equal(first.observe(("joint_1",), times), other.observe(("joint_1",), times))


def test_an_experiment_names_the_file_and_keeps_its_content(tmp_path):
    path = new_experiment("rob", ["dynamixel"], "run", tmp_path)
    (tmp_path / "arm.xml").write_text(ARM)
    path.write_text(path.read_text().replace('# scene = "arm.xml"', 'scene = "arm.xml"'))
    scene = load_experiment(path).experiment.rig.scene
    assert (scene.plugin, scene.settings["model"].lstrip()[:7]) == ("robot", "<mujoco")
    with pytest.raises(SpecError, match=r'cannot find the file "arn\.xml"'):
        load_experiment(path, ["rig.scene=arn.xml"])
