"""An MJCF or URDF file alone is a model: joints, actuators and sites come from it, what is left out is said."""

import mujoco
import numpy as np
import pytest

from labrun.errors import ModelError
from labrun.models import load_model, parse_model, read_robot, robot_table, simulate

URDF = """
<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="package://arm/upper.stl"/></geometry></visual></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="2" effort="10" velocity="3"/><dynamics damping="0.1"/></joint></robot>
"""
MJCF = """
<mujoco model="two"><include file="defaults.xml"/><asset><mesh name="m" file="not-there.stl"/></asset><worldbody>
<geom type="plane" size="1 1 .1"/>
<body name="x"><joint name="j-1" axis="0 1 0"/><geom type="mesh" mesh="m"/>
<inertial pos="0 0 -.1" mass="1" diaginertia="1e-2 1e-2 1e-2"/>
<body name="y" pos="0 0 -.2"><joint name="j-2" axis="0 1 0"/>
<inertial pos="0 0 -.1" mass="1" diaginertia="1e-2 1e-2 1e-2"/></body></body></worldbody>
<actuator><position name="p" joint="j-1" kp="20" kv="1"/><motor joint="j-2"/>
<general name="g" joint="j-2" gainprm="3" biastype="affine" biasprm="1 0 -1"/><velocity name="v" joint="j-1" kv="2"/>
</actuator><equality><joint joint1="j-2" polycoef="0 0 0 0 0"/></equality></mujoco>
"""


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    return path


@pytest.fixture
def two(tmp_path):
    (tmp_path / "two.xml").write_text(MJCF)
    (tmp_path / "defaults.xml").write_text('<mujoco><default><joint damping="3"/></default></mujoco>')
    return tmp_path / "two.xml"


def test_every_joint_is_an_output_and_a_site(two):
    model = load_model(two)
    assert [output.name for output in model.outputs] == ["j_1", "j_2"]
    assert [(site.name, site.coordinate, site.rate) for site in model.sites] == [
        ("j_1", "j_1", "j_1_rate"), ("j_2", "j_2", "j_2_rate"),
    ]  # fmt: skip


def test_a_control_means_what_the_actuators_force_says(two):
    robot = read_robot(two)
    assert [(actuator.joint, actuator.command, actuator.unit) for actuator in robot.actuators] == [
        ("j-1", "position", "rad"), ("j-2", "torque", "N m"), ("j-2", "other", "1"), ("j-1", "velocity", "rad/s"),
    ]  # fmt: skip
    assert len({actuator.input for actuator in robot.actuators}) == 4


def test_included_files_are_read_and_what_is_left_out_is_said(two):
    robot = read_robot(two)
    message = " ".join(robot.remarks)
    for words in ("1 mesh is missing", "contacts are switched off", "1 equality constraint is kept"):
        assert words in message
    assert load_model(two).values[0] == pytest.approx(3.0)  # the damping of the included defaults
    assert "not-there" not in robot.xml


def test_a_urdf_hangs_still_and_falls_like_a_pendulum(arm):
    model = load_model(arm)
    time_s = np.linspace(0.0, 0.5, 101)
    result = simulate(
        model, time_s, np.zeros((101, 0)), initial_state=[0.1, 0.0], parameters={"shoulder_damping": 0.0}
    )
    inertia, moment = 1e-3 + 0.5 * 0.1**2, 0.5 * 9.81 * 0.1
    expected = 0.1 * np.cos(np.sqrt(moment / inertia) * time_s)
    # the small-angle error is of this order
    assert np.abs(result.outputs[:, 0] - expected).max() < 0.1 * 0.1**2


@pytest.mark.parametrize(("drive", "unit"), [("position", "rad"), ("torque", "N m")])
def test_a_joint_without_an_actuator_gets_the_one_that_is_asked_for(arm, drive, unit):
    robot = read_robot(arm, {"shoulder": drive})
    assert [(actuator.command, actuator.unit) for actuator in robot.actuators] == [(drive, unit)]
    assert "shoulder: the file has no actuator there" in " ".join(robot.remarks)


def test_of_a_servo_that_the_file_lacks_gain_braking_and_rotor_are_free(arm):
    parameters = parse_model(robot_table(read_robot(arm, {"shoulder": "position"})), "arm").parameters
    assert {parameter.name for parameter in parameters if parameter.tolerance == "free"} == {
        "shoulder_kp", "shoulder_damping", "shoulder_armature",
    }  # fmt: skip


def test_a_last_body_that_is_balanced_about_its_joint_takes_no_load(tmp_path):
    (tmp_path / "turret.xml").write_text(
        '<mujoco><worldbody><body name="x"><joint name="j" axis="0 0 1"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    names = [parameter.name for parameter in load_model(tmp_path / "turret.xml").parameters]
    assert "x_mass" in names
    assert "tip_load" not in names


def test_a_base_that_is_free_is_said_to_fall(tmp_path):
    (tmp_path / "leg.xml").write_text(
        '<mujoco><worldbody><body name="torso"><freejoint/><geom size="0.1"/><body name="x">'
        '<joint name="j" axis="0 1 0"/><geom size="0.1"/></body></body></worldbody></mujoco>'
    )
    assert any("nothing holds its free base" in remark for remark in read_robot(tmp_path / "leg.xml").remarks)


def test_a_robots_file_is_one_that_mujoco_3_reads_too(two):
    xml = read_robot(two).xml
    assert mujoco.MjModel.from_xml_string(xml).actuator_gainprm[0, 0] == 20.0
    assert "input=" not in xml  # of MuJoCo 4; 3.2 says "unrecognized attribute"


def test_a_mass_that_only_a_missing_mesh_would_tell_is_refused(tmp_path):
    (tmp_path / "a.xml").write_text(
        '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody><body name="x"><joint/>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ModelError, match="the mass of x would come from a mesh that is missing"):
        read_robot(tmp_path / "a.xml")


def test_what_meshes_weigh_stays_and_the_robot_needs_no_other_file(tmp_path):
    (tmp_path / "meshes").mkdir()
    corners = ("0 0 0", "1 0 0", "0 1 0", "0 0 1")
    faces = ((1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4))
    lines = [f"v {corner}" for corner in corners] + [f"f {a} {b} {c}" for a, b, c in faces]
    (tmp_path / "meshes" / "m.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "a.xml").write_text(
        '<mujoco><compiler meshdir="meshes" texturedir="gone"/><asset><mesh name="m" file="m.obj"/>'
        '<texture name="t" type="2d" file="wood.png"/><material name="w" texture="t"/></asset><worldbody>'
        '<body name="x"><joint name="j"/><geom type="mesh" mesh="m" density="60" material="w"/></body></worldbody>'
        "</mujoco>"
    )
    xml = read_robot(tmp_path / "a.xml").xml
    assert "m.obj" not in xml
    assert "wood.png" not in xml
    # a corner of a cube, cut off: a sixth of its volume
    assert mujoco.MjModel.from_xml_string(xml).body("x").mass[0] == pytest.approx(60 / 6)


@pytest.mark.parametrize("text", ["no xml at all", "<mujoco><nonsense/></mujoco>"])
def test_a_file_that_mujoco_cannot_read_is_told(tmp_path, text):
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(ModelError, match="MuJoCo cannot read"):
        load_model(tmp_path / "a.xml")


def test_the_file_says_that_inertia_follows_mass_and_why_a_servos_kv_stays(two):
    two.write_text(MJCF.replace('<velocity name="v" joint="j-1" kv="2"/>', ""))
    lines = robot_table(read_robot(two)).splitlines()
    message = next(index for index, line in enumerate(lines) if line.startswith("# a body's inertia"))
    assert lines[message - 1] == "[mjcf]"
    assert any(line.startswith('"body.x.inertia[0]" = ') for line in lines[message + 1 :])
    gain = next(index for index, line in enumerate(lines) if line.startswith("p_kp = "))
    assert lines[gain + 1].startswith("# its kv of 1 stays")
    assert not any(line.startswith("# its kv") for line in lines[gain + 2 :])
