"""A check of a dry run looks at the bench as well, and moves nothing."""

import pytest

from labrun.app.check import check
from labrun.errors import DeviceError

ARM = """
<mujoco><worldbody><body><joint name="shoulder" axis="0 1 0"/>
<inertial pos="0 0 -.1" mass=".3" diaginertia="1e-3 1e-3 1e-3"/>
</body></worldbody><actuator><position name="shoulder" joint="shoulder" kp="8"/></actuator></mujoco>
"""
FILE = """
title = "an arm"
kind = "run"
[rig]
scene = "arm.xml"
[rig.devices.servos]
plugin = "dynamixel"
port = "/dev/ttyUSB0"
joints = { JOINT = { id = 1 } }
limits = { angle_deg = [-90, 90], speed_deg_s = 180 }
[gait]
plugin = "sine"
joints.JOINT = { amplitude_deg = "a", frequency_hz = 1 }
[trial]
cycles = 3
[run]
conditions = [{ a = 5 }]
"""


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path / "arm.toml"


def test_a_joint_that_the_simulated_bench_lacks_is_told_before_a_dry_run(arm):
    arm.write_text(FILE.replace("JOINT", "sholder"))
    assert check(arm, dry_run=False).trials == 1, "the real bench may have it"
    with pytest.raises(DeviceError, match="this bench has no joint sholder") as raises:
        check(arm, dry_run=True)
    assert "it has shoulder" in raises.value.hint


def test_a_bench_with_all_joints_passes_the_check_of_a_dry_run(arm):
    arm.write_text(FILE.replace("JOINT", "shoulder"))
    assert check(arm, dry_run=True).trials == 1


TANK = """
title = "Thrust of a tail"
kind = "run"
[rig]
scene = "caudal-tank"
[rig.devices.tail]
plugin = "arduino-servo"
port = "/dev/ttyACM0"
[rig.devices.wrench]
plugin = "robotiq-ft300"
port = "/dev/ttyUSB0"
[gait]
plugin = "sine"
joints.tail = { amplitude_deg = "a", frequency_hz = 1 }
[trial]
cycles = 3
TARE
[objectives.thrust]
plugin = "cycle-mean"
channel = "wrench.force_x"
[run]
conditions = [{ a = 5 }]
"""


def notes_of(folder, text):
    (folder / "tank.toml").write_text(text)
    return [note for note in check(folder / "tank.toml").notes if "zero is never taken" in note]


def test_an_objective_of_a_force_that_is_never_tared_is_warned_of(tmp_path):
    (note,) = notes_of(tmp_path, TANK.replace("TARE", ""))
    assert note.startswith("objective thrust reads wrench.force_x, whose zero is never taken")
    assert "[trial]" in note


@pytest.mark.parametrize(
    ("result", "changed"),
    [
        ("TARE", "tare = { duration_s = 1 }"),
        ("TARE", 'tare = { duration_s = 1, devices = ["wrench"] }'),
        ('"cycle-mean"', '"amplitude"'),
        ('"cycle-mean"', '"extremes"\nwhich = "range"'),
    ],
)
def test_a_tare_or_an_objective_that_no_offset_changes_needs_no_warning(tmp_path, result, changed):
    assert notes_of(tmp_path, TANK.replace(result, changed).replace("TARE", "")) == []


def test_both_channels_of_a_direction_need_a_zero(tmp_path):
    direction = '"direction"\nside_channel = "wrench.force_y"'
    notes = notes_of(tmp_path, TANK.replace("TARE", "").replace('"cycle-mean"', direction))
    assert ["force_x" in note for note in notes] == [True, False]


def test_a_bias_or_a_calibration_that_states_the_zero_needs_no_tare(tmp_path):
    analogue = TANK.replace('"robotiq-ft300"\nport = "/dev/ttyUSB0"', '"ati-daq"\nBIAS').replace("TARE", "")
    keys = 'calibration_file = "FT1.cal"\n'
    assert len(notes_of(tmp_path, analogue.replace("BIAS", keys))) == 1
    assert notes_of(tmp_path, analogue.replace("BIAS", f"{keys}bias_v = [0.1, 0, 0, 0, 0, 0]")) == []
