"""A load on the last link of an arm, from the torques of all joints together."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from labrun.fit import Dataset, FitTrial
from labrun.gap.robot.one_joint import Prescribed, prescribed
from labrun.gap.robot.tip_load import place_of_load
from labrun.models import load_model, read_robot
from labrun.store import SignalInfo

XML = """
<mujoco model="arm"><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/><worldbody>
<body name="base"><joint name="turn" axis="0 0 1" damping="0.5" armature="0.05"/>
<inertial pos="0 0.02 0.1" mass="2" diaginertia="0.01 0.01 0.01"/>
<body name="upper" pos="0 0 0.2"><joint name="shoulder" axis="0 1 0" damping="0.5" armature="0.05"/>
<inertial pos="0.01 0 0.15" mass="1.2" diaginertia="0.01 0.01 0.002"/>
<body name="lower" pos="0 0 0.3"><joint name="elbow" axis="0 1 0" damping="0.2" armature="0.02"/>
<inertial pos="0 0.01 0.1" mass="0.6" diaginertia="0.003 0.003 0.001"/>
<body name="hand" pos="0 0 0.2"><joint name="wrist" axis="1 0 0" damping="0.05" armature="0.005"/>
<inertial pos="0.01 0 0.05" mass="0.3" diaginertia="4e-4 4e-4 1e-4"/></body></body></body></body></worldbody><actuator>
<position name="turn" joint="turn" kp="120" kv="8"/><position name="shoulder" joint="shoulder" kp="200" kv="10"/>
<position name="elbow" joint="elbow" kp="80" kv="4"/><position name="wrist" joint="wrist" kp="15" kv="0.7"/>
</actuator></mujoco>
"""
FAR_END_M = (0.02, 0.0, 0.1)
SAMPLE_S, SAMPLES, TRIALS, NOISE = 0.01, 400, 5, 1e-4


def logged(tmp_path: Path, load_kg: float, place_m: tuple[float, float, float], gain: float) -> Prescribed:
    """Return what the joints carry in a log of the arm with a ball on its hand, and gains that are off."""
    spec = mujoco.MjSpec.from_string(XML)
    if load_kg:
        ball = spec.body("hand").add_body(pos=place_m)
        ball.mass, ball.ipos, ball.inertia, ball.explicitinertial = load_kg, [0, 0, 0], [1e-9] * 3, True
    native = spec.compile()
    native.actuator_gainprm[:, 0] *= gain
    native.actuator_biasprm[:, 1:3] *= gain
    rng, data = np.random.default_rng(8), mujoco.MjData(native)
    time_s = np.arange(SAMPLES) * SAMPLE_S
    fade = np.sin(np.pi * np.arange(SAMPLES) / SAMPLES) ** 1.5
    trials = []
    for k in range(TRIALS):
        mujoco.mj_resetData(native, data)
        frequency, phase = rng.uniform(0.3, 1.2, (4, 2)), rng.uniform(0, 6, (4, 2))
        goals = (
            0.5 * fade[:, None] * np.sin(2 * np.pi * time_s[:, None, None] * frequency + phase).sum(axis=2)
        )
        angles = np.empty_like(goals)
        for row in range(SAMPLES):
            angles[row], data.ctrl[:] = data.qpos, goals[row]
            mujoco.mj_step(native, data, nstep=10)
        angles += NOISE * rng.standard_normal(angles.shape)
        trials.append(FitTrial(f"trial {k}", {"motion": f"m{k}"}, 1, time_s, goals, angles))
    file = tmp_path / "arm.xml"
    file.write_text(XML, encoding="utf-8")
    robot, model = read_robot(file), load_model(file)
    inputs = tuple(SignalInfo(signal.name, signal.unit, "hold") for signal in model.inputs)
    outputs = tuple(SignalInfo(output.name, output.unit) for output in model.outputs)
    return prescribed(robot, model, Dataset("arm", tmp_path, "recording", inputs, outputs, tuple(trials)))


def test_a_load_starts_to_be_looked_for_where_the_last_link_ends(tmp_path):
    assert logged(tmp_path, 0.0, FAR_END_M, 1.0).tip.far_end == pytest.approx(FAR_END_M)


@pytest.mark.parametrize(
    ("place_m", "gain"), [((0.02, 0.0, 0.1), 0.93), ((-0.03, 0.04, 0.12), 1.0), ((0.0, 0.0, 0.03), 0.93)]
)
def test_the_place_of_a_load_is_found_beside_gains_that_are_off(tmp_path, place_m, gain):
    result = logged(tmp_path, 0.4, place_m, gain)
    position = place_of_load(result, result.tip)
    assert position == pytest.approx(place_m, abs=4e-3)


def test_a_load_that_is_known_leaves_none_to_be_looked_for(tmp_path):
    result = logged(tmp_path, 0.4, (-0.03, 0.04, 0.12), 1.0)
    there = result.with_load_at(result.tip.torque(np.array([-0.03, 0.04, 0.12])))
    position = place_of_load(there.loaded(0.4), result.tip)
    assert position is None or position != pytest.approx([-0.03, 0.04, 0.12], abs=4e-3)
