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
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path / "arm.toml"


def test_a_joint_that_the_simulated_bench_lacks_is_told_before_a_dry_run(arm):
    arm.write_text(FILE.replace("JOINT", "sholder"))
    assert check(arm, dry_run=False).trials == 1, "the real bench may have it"
    with pytest.raises(DeviceError, match="this bench has no joint sholder") as told:
        check(arm, dry_run=True)
    assert "it has shoulder" in told.value.hint


def test_a_bench_with_all_joints_passes_the_check_of_a_dry_run(arm):
    arm.write_text(FILE.replace("JOINT", "shoulder"))
    assert check(arm, dry_run=True).trials == 1
