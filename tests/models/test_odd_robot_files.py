"""Robot files with names that meet, links that are missing, and inertias that no body can have."""

import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from labrun.errors import ModelError
from labrun.models import parse_model, read_robot, robot_table
from labrun.models.mjcf.soundness import nearest_inertia

BODY = (
    '<body name="{body}" pos="0 0 -.2"><joint name="{joint}" axis="0 1 0" damping="1"/>'
    '<inertial pos="0 0 -.1" mass="1" diaginertia="1e-2 1e-2 1e-2"/>'
)
TWO = (
    "<mujoco><worldbody>" + BODY.format(body="a-1", joint="shoulder") + BODY.format(body="a_1", joint="elbow")
    + "</body></body></worldbody>{tendon}<actuator>{actuators}</actuator></mujoco>"
)  # fmt: skip
TENDON = (
    '<tendon><fixed name="cable"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="1"/></fixed>'
    "</tendon>"
)
URDF = (
    '<robot name="arm">{base}<link name="upper"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>'
    '<inertia ixx="1e-3" iyy="1e-3" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>'
    '<limit lower="-1" upper="2" effort="10" velocity="3"/></joint></robot>'
)


def robot_of(tmp_path, text, name="arm.xml", **options):
    (tmp_path / name).write_text(text)
    return read_robot(tmp_path / name, **options)


@pytest.mark.parametrize("drives", [None, {"elbow": "position"}, {"elbow": "torque"}, "undriven"])
def test_an_actuator_named_like_a_joint_that_it_does_not_drive_alone(tmp_path, drives):
    actuators = '<motor name="elbow" tendon="cable"/><position name="shoulder" joint="shoulder" kp="9"/>'
    robot = robot_of(tmp_path, TWO.format(tendon=TENDON, actuators=actuators), drives=drives)
    inputs = [actuator.input for actuator in robot.actuators]
    assert inputs[:2] == ["elbow_tendon_torque", "shoulder_command"]
    assert len(set(inputs)) == len(inputs)
    assert ("elbow" in [actuator.joint for actuator in robot.actuators]) == (drives is not None)
    assert any("actuator elbow does not drive joint elbow" in remark for remark in robot.remarks)
    parse_model(robot_table(robot), "robot")


def test_actuators_with_swapped_names_are_called_after_what_they_drive(tmp_path):
    actuators = (
        '<position name="elbow" joint="shoulder" kp="9"/><position name="shoulder" joint="elbow" kp="4"/>'
    )
    robot = robot_of(tmp_path, TWO.format(tendon="", actuators=actuators))
    assert [(actuator.input, actuator.joint) for actuator in robot.actuators] == [
        ("shoulder_command", "shoulder"),
        ("elbow_command", "elbow"),
    ]
    assert sum("does not drive joint" in remark for remark in robot.remarks) == 2
    model = parse_model(robot_table(robot), "robot")
    assert {"shoulder_kp", "elbow_kp"} <= {parameter.name for parameter in model.parameters}


@settings(max_examples=15)
@example(names=["a.b", "a-b", "a_b"])
@example(names=["é", "ü"])
@given(names=st.lists(st.text("aA1_-./ ", min_size=1, max_size=3), min_size=2, max_size=4, unique=True))
def test_names_that_differ_in_replaced_characters_alone_do_not_meet(tmp_path_factory, names):
    bodies = "".join(BODY.format(body=name, joint=name) for name in names)
    actuators = "".join(f'<motor name="{name}" joint="{name}"/>' for name in names)
    text = f"<mujoco><worldbody>{bodies}{'</body>' * len(names)}</worldbody><actuator>{actuators}</actuator></mujoco>"
    robot = robot_of(tmp_path_factory.mktemp("robot"), text)
    model = parse_model(robot_table(robot), "robot")
    assert len(model.outputs) == len(model.inputs) == len(names)
    assert len({signal.name for signal in (*model.outputs, *model.inputs)}) == 2 * len(names)


@pytest.mark.parametrize("names", [("shoulder", "shoulder_rate"), ("shoulder_rate", "shoulder")])
def test_a_joint_called_like_the_rate_of_another_has_a_state_of_its_own(tmp_path, names):
    text = "<mujoco><worldbody>{}{}</body></body></worldbody></mujoco>".format(
        *(BODY.format(body=f"link_{name}", joint=name) for name in names)
    )
    model = parse_model(robot_table(robot_of(tmp_path, text)), "robot")
    states = {state for output in model.outputs for state in (output.name, f"{output.name}_rate")}
    assert len(states) == 4


@pytest.mark.parametrize(
    ("base", "hint"), [("", '<link name="base"/>'), ('<link name="bases"/>', 'did you mean "bases"')]
)
def test_a_urdf_whose_parent_link_is_not_declared_is_told_what_to_add(tmp_path, base, hint):
    with pytest.raises(ModelError, match="joint 'shoulder' has link 'base' as its parent") as error:
        robot_of(tmp_path, URDF.format(base=base, izz="1e-3"), "arm.urdf")
    assert hint in error.value.hint


@pytest.mark.parametrize("name", ["arm.urdf.xacro", "arm.urdf"])
def test_xacro_is_named_with_the_command_that_makes_a_urdf_of_it(tmp_path, name):
    text = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="a"><xacro:include filename="b"/></robot>'
    with pytest.raises(ModelError, match="is xacro") as error:
        robot_of(tmp_path, text, name)
    assert error.value.hint == f"xacro {name} > arm.urdf"


def test_a_urdf_that_xacro_has_made_is_a_urdf(tmp_path):
    text = URDF.format(base='<link name="base"/>', izz="1e-3")
    text = text.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    assert len(robot_of(tmp_path, text, "arm.urdf").joints) == 1


def test_a_negative_mass_is_named_with_its_link(tmp_path):
    text = URDF.format(base='<link name="base"/>', izz="1e-3").replace(
        'mass value="0.5"', 'mass value="-0.5"'
    )
    with pytest.raises(ModelError, match=r"link upper has a mass of -0.5 kg"):
        robot_of(tmp_path, text, "arm.urdf", repair=True)


@pytest.mark.parametrize("izz", ["9e-3", "-1e-3"])
def test_an_inertia_that_no_body_can_have_is_named_and_repaired_if_asked(tmp_path, izz):
    text = URDF.format(base='<link name="base"/>', izz=izz)
    with pytest.raises(ModelError, match=r"no body can have the inertia of upper \(") as error:
        robot_of(tmp_path, text, "arm.urdf")
    assert "--repair" in error.value.hint
    robot = robot_of(tmp_path, text, "arm.urdf", repair=True)
    assert any("upper" in remark and "replaced by the nearest possible" in remark for remark in robot.remarks)
    moments = mujoco.MjModel.from_xml_string(robot.xml).body("upper").inertia
    assert moments.min() > 0
    assert moments.max() <= (1 + 1e-6) * (moments.sum() - moments.max())


@given(entries=st.lists(st.floats(-10, 10), min_size=6, max_size=6))
def test_the_nearest_inertia_is_possible_and_a_possible_one_stays(entries):
    matrix = np.zeros((3, 3))
    matrix[np.triu_indices(3)] = entries
    matrix = 0.5 * (matrix + matrix.T)
    possible = nearest_inertia(matrix)
    moments = np.linalg.eigvalsh(possible)
    assert moments[0] > 0
    assert moments[2] <= (1 + 1e-9) * (moments[0] + moments[1])
    assert nearest_inertia(possible) == pytest.approx(possible, abs=1e-9)
