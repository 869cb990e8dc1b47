"""The page "your robot, your log" with its diagnosis: what is hidden is found, and MuJoCo alone moves like it."""

import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from pages import blocks

from labrun.app.diagnose_robot import diagnose_joints
from labrun.app.logs import import_log
from labrun.app.simulators import export_robot

PAGE = Path(__file__).parents[2] / "docs" / "your-robot-your-log.md"


@pytest.mark.slow
def test_the_friction_that_the_page_hides_is_found_and_exported(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for block in blocks(PAGE):
        if block.file == "arm.xml":
            Path(block.file).write_text(block.body)
        if block.language == "python":
            subprocess.run([sys.executable, "-c", block.body], check=True)
    folder = import_log("log.csv", "arm.xml", "recordings/arm").folder
    joints = diagnose_joints(folder, workers=2)
    assert joints.diagnosis.joints[0].diagnosis.causes[0].name.effect.endswith("-friction")
    assert joints.diagnosis.joints[0].diagnosis.causes[0].name.site == "shoulder"
    made = export_robot(folder, Path("corrected.xml"), ranges=Path("ranges.json"))
    ranges = json.loads(Path("ranges.json").read_text())
    assert {event["params"]["operation"] for event in ranges["isaac_lab"]} == {"abs"}
    for parameter in ranges["parameters"]:
        assert parameter["low"] <= parameter["value"] <= parameter["high"]
    log = np.genfromtxt("log.csv", delimiter=",", names=True)
    errors = {}
    for file in ("arm.xml", made.file):
        native = mujoco.MjModel.from_xml_path(str(file))
        data, course = mujoco.MjData(native), []
        for goal in log["shoulder_goal"]:
            course.append(float(data.qpos[0]))
            data.ctrl[0] = goal
            mujoco.mj_step(native, data, nstep=round(0.02 / native.opt.timestep))
        errors[file] = np.sqrt(np.mean((np.array(course) - log["shoulder_pos"]) ** 2))
    print("rms error of arm.xml and corrected.xml, rad:", *errors.values())
    assert errors[made.file] < 0.25 * errors["arm.xml"]
