"""A robot's diagnosis in a terminal."""

from dataclasses import replace

import gap_examples as examples

from labrun.gap import Cause, JointDiagnosis, Name, ResampledNumber, RobotDiagnosis
from labrun.models import RobotJoint
from labrun.report.robot import robot_lines, robot_page

LOAD = Cause(Name("payload", "tip"), 0.9, {"mass": ResampledNumber(0.31, 0.28, 0.34)})


def robot_with_a_load():
    """Return a robot of two joints that both tell a load."""
    answer = replace(examples.explained(), causes=(LOAD,))
    joints = tuple(
        JointDiagnosis(RobotJoint(name, name, "rad", None), answer, 0.1, 0.1, 0.01)
        for name in ("shoulder", "elbow")
    )
    inertia = {"mass": 0.3, "x": 0.01, "y": 0.0, "z": 0.2}
    whole = (("payload", ("shoulder", "elbow"), inertia),)
    return RobotDiagnosis("arm", "arm", "recordings/arm", joints, whole, (), {}, (), 1.0)


def test_a_load_is_told_with_the_joints_that_tell_it_its_unit_and_its_place():
    lines = robot_lines(robot_with_a_load())
    assert "payload, told by shoulder: mass 0.310 [0.280, 0.340] kg" in [
        line.replace("\u00a0", " ") for line in lines
    ]
    assert (
        "payload of the whole robot: mass 0.3 kg, x 0.01 m, y 0 m, z 0.2 m, in the frame of the last body"
        in lines
    )


def test_the_page_says_the_unit_of_a_load_and_its_place():
    page = robot_page(robot_with_a_load()).replace("\u00a0", " ")
    assert "[0.280, 0.340] kg" in page
    assert "payload of the whole robot: mass 0.3 kg, x 0.01 m" in page
