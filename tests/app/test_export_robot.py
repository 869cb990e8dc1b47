"""A diagnosed robot for other simulators: the corrected MJCF, and ranges as fields of theirs."""

import json
import os

import mujoco
import numpy as np
import pytest

from labrun.app.simulators import export_robot
from labrun.errors import RequestError
from labrun.models import load_model, simulate

ARM = """
<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" damping="0.2"/>
<inertial pos="0 0 -.1" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody>
<actuator><position name="shoulder" joint="shoulder" kp="8"/></actuator></mujoco>
"""
MODEL = """
name = "arm"
mujoco = "arm.xml"
states = { shoulder = "joint.shoulder.position", shoulder_rate = "joint.shoulder.velocity" }
[inputs]
goal = { mjcf = "actuator.shoulder", unit = "rad", between = "hold" }
[parameters]
shoulder_damping = { mjcf = "joint.shoulder.damping", tolerance = "free", unit = "N m s/rad" }
shoulder_kp = { mjcf = "actuator.shoulder.kp", tolerance = 0.1, unit = "N m/rad" }
upper_mass = { mjcf = "body.upper.mass", tolerance = 0.05, unit = "kg" }
[outputs]
shoulder = { mjcf = "joint.shoulder.position", unit = "rad" }
[sites.shoulder]
kind = "joint"
joint = "shoulder"
[initial]
shoulder = 0.0
shoulder_rate = 0.0
"""
RECORDING = """
experiment = "arm"
[channels.goal]
kind = "input"
unit = "rad"
between = "hold"
[channels.shoulder]
kind = "output"
unit = "rad"
"""


def diagnosed(folder):
    """Return the diagnosis of three motions of the arm whose damping is half as large again as its file says."""
    (folder / "arm.xml").write_text(ARM)
    (folder / "model.toml").write_text(MODEL)
    model, rng = (
        load_model(folder / "model.toml").with_values({"shoulder_damping": 0.3}),
        np.random.default_rng(1),
    )
    message, time_s = RECORDING, np.arange(0.0, 1.5, 0.02)
    for number, amplitude in enumerate((0.3, 0.6, 0.9)):
        goal = amplitude * np.sin(2 * np.pi * time_s)
        angle = simulate(model, time_s, goal[:, None], initial_state=[0.0, 0.0]).outputs[:, 0]
        rows = np.column_stack([time_s, goal, angle + 1e-3 * rng.standard_normal(len(angle))])
        np.savetxt(folder / f"{number}.csv", rows, delimiter=",", header="time_s,goal,shoulder", comments="")
        message += f'[[trials]]\nfile = "{number}.csv"\ncondition = {{ amplitude = {amplitude} }}\n'
    (folder / "recording.toml").write_text(message)
    stored = folder / "diagnosis.json"
    stored.write_text(json.dumps({
        "name": "arm", "verdict": "no-gap", "sentence": "Recalibrated.", "source": str(folder), "causes": [],
        "model_source": str(folder / "model.toml"), "corrected": {"shoulder_damping": 0.29}, "effects": [],
        "data": {"trials": 3, "conditions": 3},
    }))  # fmt: skip
    return stored


def test_ranges_are_fields_of_isaac_lab_and_mjlab(tmp_path):
    made = export_robot(diagnosed(tmp_path), tmp_path / "out.xml", ranges=tmp_path / "ranges.json")
    loads = json.loads(made.ranges.read_text())
    ranges = {parameter["array"]: parameter for parameter in loads["parameters"]}
    assert ranges["dof_damping"]["low"] < 0.3 < ranges["dof_damping"]["high"]
    isaac = {
        next(key for key in event["params"] if key.endswith("_params")): event for event in loads["isaac_lab"]
    }
    damping = isaac["damping_distribution_params"]
    assert damping["func"] == "randomize_actuator_gains"
    assert damping["params"]["asset_cfg"] == {"name": "robot", "joint_names": ["shoulder"]}
    assert damping["params"]["damping_distribution_params"] == [
        ranges["dof_damping"]["low"], ranges["dof_damping"]["high"],
    ]  # fmt: skip
    assert isaac["mass_distribution_params"]["params"]["asset_cfg"]["body_names"] == ["upper"]
    mjlab = {event["func"]: event["params"] for event in loads["mjlab"]}
    assert mjlab["dr.body_mass"]["asset_cfg"] == {"name": "robot", "body_names": ["upper"]}
    assert mjlab["dr.body_mass"]["operation"] == "abs"
    low, high = mjlab["dr.pd_gains"]["kp_range"]
    assert low < 1.0 < high
    assert mjlab["dr.pd_gains"]["kd_range"] == [1.0, 1.0]
    assert mujoco.MjModel.from_xml_path(str(made.file)).dof_damping.ravel()[0] == pytest.approx(0.29)


def test_of_recordings_that_state_one_name_each_has_its_own_diagnosis(tmp_path):
    results = tmp_path / "results"
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        stored = diagnosed(tmp_path / name)
        kept = results / "arm" / f"gap-{name}"
        kept.mkdir(parents=True)
        stored.rename(kept / "diagnosis.json")
    loads = json.loads((results / "arm" / "gap-first" / "diagnosis.json").read_text())
    loads["corrected"] = {"shoulder_damping": 0.25}
    (results / "arm" / "gap-first" / "diagnosis.json").write_text(json.dumps(loads))
    made = [
        export_robot(tmp_path / name, tmp_path / f"{name}.xml", results=results).file
        for name in ("first", "second")
    ]
    damping = [float(mujoco.MjModel.from_xml_path(str(file)).dof_damping[0]) for file in made]
    assert damping == pytest.approx([0.25, 0.29])
    (tmp_path / "third").mkdir()
    diagnosed(tmp_path / "third").unlink()
    with pytest.raises(RequestError, match="has no diagnosis yet"):
        export_robot(tmp_path / "third", tmp_path / "third.xml", results=results)


def test_its_own_diagnosis_comes_before_a_newer_one_of_a_recording_that_is_gone(tmp_path):
    kept = {name: tmp_path / "results" / "arm" / f"gap-{name}" for name in ("own", "gone", "torn")}
    for folder in kept.values():
        folder.mkdir(parents=True)
    (tmp_path / "arm").mkdir()
    loads = json.loads(diagnosed(tmp_path / "arm").read_text())
    other = {**loads, "source": str(tmp_path / "nowhere"), "corrected": {"shoulder_damping": 0.25}}
    (kept["torn"] / "diagnosis.json").write_text("{")
    for age_s, (name, content) in enumerate((("gone", other), ("own", loads))):
        numbers = kept[name] / "diagnosis.json"
        numbers.write_text(json.dumps(content))
        os.utime(numbers, (1e9 - age_s, 1e9 - age_s))
    made = export_robot(tmp_path / "arm", tmp_path / "out.xml", results=tmp_path / "results").file
    assert mujoco.MjModel.from_xml_path(str(made)).dof_damping.ravel()[0] == pytest.approx(0.29)


def test_a_robots_own_file_is_told_what_makes_a_corrected_model_of_it(tmp_path):
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    with pytest.raises(RequestError, match=r"arm.xml is neither a corrected model nor a run") as refused:
        export_robot(tmp_path / "arm.xml", tmp_path / "made.xml")
    assert "labrun gap diagnose arm.xml --log" in str(refused.value.hint)
