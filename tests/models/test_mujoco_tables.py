"""What is wrong in a table of a model in MuJoCo is told at its line, with what would do."""

import sys

import pytest
from mjcf_files import ARM, ARM_TABLE, load

from labrun.errors import ModelError

BALL = '<mujoco><worldbody><body name="b"><joint name="hinge" type="ball"/><geom size="1"/></body></worldbody></mujoco>'


def test_a_broken_mujoco_gives_the_line_that_installs_it_again(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(
        ModelError, match=r"MuJoCo, which comes with labrun, cannot be loaded.*\n.*--force-reinstall"
    ):
        load(tmp_path, ARM_TABLE, ARM)


FAULTS = {
    ('mujoco = "arm.xml"', 'mujoco = "leg.xml"'): (
        "arm.toml:3:.*: mujoco = .*cannot find the MJCF file",
        "counted from",
    ),
    ('"joint.hinge.position"', '"joint.hing.position"'): (
        "arm.toml:5:.*: states.angle = .* no joint 'hing'",
        '"hinge"',
    ),
    ('rate  = "joint.hinge.velocity"', 'rate = "joint.hinge.acceleration"'): (
        "states.rate.*is not a state",
        "",
    ),
    ('"joint.hinge.velocity"', '"joint.hinge.speed"'): (
        "arm.toml:6:.*: states.rate = .* no 'speed'",
        "velocity",
    ),
    ('"actuator.motor", unit', '"actuator.moter", unit'): ("arm.toml:8:.*: .*no actuator 'moter'", '"motor"'),
    ('"actuator.motor", unit', '"sensor.motor", unit'): (
        "arm.toml:8:.*: .*names no part",
        "known names: actuator",
    ),
    ('"body.arm.mass"', '"body.arm.mas"'): (
        "arm.toml:10:.*: parameters.mass.mjcf = .*a body has no 'mas'",
        '"mass"',
    ),
    ('"body.arm.mass"', '"body.arm.inertia"'): ("body.arm.inertia has 3 numbers", r"inertia\[0\] to"),
    ('"body.arm.mass"', '"body.arm.inertia[3]"'): (r"\[3\] is out of range", ""),
    ('"body.arm.mass"', '"joint.hinge.damping"'): ("arm.toml:12:.*: .*line 10 sets the same number", ""),
    ('"body.arm.mass"', '"actuator.motor.kp"'): ("not a position servo", r"gainprm\[0\]"),
    ('"body.arm.mass"', '"option.gravty[2]"'): ("unknown option 'gravty'", '"gravity"'),
    ('{ mjcf = "body.arm.mass", tolerance', "{ value = 1.0, tolerance"): (None, ""),
    ('"actuator.motor.force"', '"actuator.motor.power"'): (
        "arm.toml:15:.*: outputs.torque.*'power'",
        "known names: force",
    ),
    ('"actuator.motor.force"', '"sensor.imu"'): ("no sensor 'imu'", "no sensor of it has a name"),
    ('kind = "joint"', 'kind = "input"'): ("arm.toml:17:.*: sites.hinge.kind", ""),
    ('kind = "joint"', 'joint = "knee"'): (
        "arm.toml:17:.*: sites.hinge.joint = .*no joint 'knee'",
        'did you mean "hinge"',
    ),
    ('stiffness = "stiffness"', 'stiffness = "stifness"'): (
        "arm.toml:18:.*: .*unknown parameter 'stifness'",
        '"stiffness"',
    ),
    ("[outputs]", '[mjcf]\n"geom.x.friction" = "mass"\n[outputs]'): (
        "arm.toml:14:.*: .*no geom 'x'",
        "has a name",
    ),
    ("[outputs]", '[mjcf]\n"joint.hinge.armature" = "angle"\n[outputs]'): (
        "arm.toml:14:.*: .*'angle', which moves",
        "",
    ),
    ("[outputs]", '[mjcf]\n"joint.hinge.armature" = "mass*"\n[outputs]'): (
        r"arm.toml:14:.*: .*\n.*mass\*\n.*\^",
        "",
    ),
    ("[outputs]", "[parameters.spare]\nvalue = 1\n[outputs]"): (
        "arm.toml:13:.*: .*no equation uses 'spare'",
        "",
    ),
    ("[outputs]", "[equations]\n[outputs]"): ("arm.toml:13:.*: equations: unknown key", ""),
    ('angle = "first"', 'angel = "first"'): ("initial.angel = .*unknown state", '"angle"'),
}


@pytest.mark.parametrize("change", FAULTS)
def test_a_fault_in_the_table_is_told_at_its_line(change, tmp_path):
    assert change[0] in ARM_TABLE
    message, hint = FAULTS[change]
    table = ARM_TABLE.replace(*change, 1)
    if message is None:  # the parameter is still used by the load
        assert load(tmp_path, table, ARM).parameters[0].value == 1.0
        return
    with pytest.raises(ModelError, match=f"(?s){message}.*{hint}"):
        load(tmp_path, table, ARM)


XML_FAULTS = {
    ("<worldbody>", "<worldbdy>"): "MuJoCo cannot read",
    ('pos="0 0 -0.25"', 'pos="0 0 0"'): "turns about its own centre of mass",
}


@pytest.mark.parametrize("change", XML_FAULTS)
def test_a_fault_in_the_mjcf_file_is_told(change, tmp_path):
    table = ARM_TABLE.replace("[outputs]", '[mjcf]\n"body.arm.ipos[2]" = "-mass"\n[outputs]')
    with pytest.raises(ModelError, match=XML_FAULTS[change]):
        load(tmp_path, table, ARM.replace(*change))


def test_a_site_is_at_a_joint_with_one_coordinate(tmp_path):
    table = 'name="b"\nmujoco="arm.xml"\n[outputs]\nw="joint.hinge.wx"\n[sites.hinge]\n'
    with pytest.raises(ModelError, match="no single coordinate"):
        load(tmp_path, table, BALL)


def test_delays_inside_mujoco_are_refused(tmp_path):
    import mujoco

    if not hasattr(mujoco.MjModel, "nhistory"):
        pytest.skip("this MuJoCo knows no delays")
    xml = ARM.replace("<motor ", '<motor delay="0.02" nsample="20" ')
    with pytest.raises(ModelError, match=r'with a delay.*effect "delay"'):
        load(tmp_path, ARM_TABLE, xml)
