"""The model file of a robot: every joint an output and a site, every actuator an input."""

from collections.abc import Collection, Iterator, Mapping
from typing import Literal

import numpy as np

from labrun.models.mjcf.around import around, heavy_bodies
from labrun.models.mjcf.inverse import JointDrive, robot_terms
from labrun.models.mjcf.robot import Robot, RobotJoint, identifier

_FREE = '"free"'
_MASS_TOLERANCE = 0.05
_GAIN_TOLERANCE = 0.1
"""What a description of a robot says of masses and gains is good to this (chosen); of damping it knows nothing."""


def robot_table(
    robot: Robot,
    *,
    xml_file: str | None = None,
    start: Literal["rest", "free"] = "rest",
    shown: Mapping[str, tuple[str, str]] | None = None,
    measured: Collection[str] | None = None,
) -> str:
    """Return the model file of a robot.

    Parameters
    ----------
    xml_file
        Where its MJCF is found, seen from the model file; None puts it into the text.
    start
        How a trial begins: at rest, or with velocities that are fitted.
    shown
        Further outputs: what of the MJCF model each is, and its unit.
    measured
        Outputs that there are; all joints if None.
    """
    names = [joint.output for joint in robot.joints] if measured is None else list(measured)
    return "\n".join(_lines(robot, xml_file, start, shown or {}, names)) + "\n"


def _lines(
    robot: Robot,
    xml_file: str | None,
    start: str,
    shown: Mapping[str, tuple[str, str]],
    measured: Collection[str],
) -> Iterator[str]:
    yield f'name   = "{robot.name}"'
    yield f'mujoco = "{xml_file}"' if xml_file else f"mujoco = '''\n{robot.xml}'''"
    yield "[states]"
    for joint in robot.joints:
        yield f'{joint.output} = "joint.{joint.name}.position"'
        yield f'{joint.output}_rate = "joint.{joint.name}.velocity"'
    if robot.actuators:
        yield "[inputs]"
    for one in robot.actuators:
        between = "hold" if one.command in ("position", "velocity") else "linear"
        yield f'{one.input} = {{ mjcf = "actuator.{one.name}", unit = "{one.unit}", between = "{between}" }}'
    parameters, equations = around(
        robot.xml, {body: f"{identifier(body)}_mass" for body in heavy_bodies(robot.xml)}
    )
    yield "[parameters]"
    yield from _parameters(robot, equations)
    yield from parameters
    yield "[mjcf]"
    for reference, equation in equations.items():
        yield f'"{reference}" = "{equation}"'
    yield "[outputs]"
    for joint in (one for one in robot.joints if one.output in measured):
        yield f'{joint.output} = {{ mjcf = "joint.{joint.name}.position", unit = "{joint.unit}" }}'
    for name, (reference, unit) in shown.items():
        yield f'{name} = {{ mjcf = "{reference}", unit = "{unit}" }}'
    terms = robot_terms(robot.xml, [one.name for one in robot.joints])
    for joint in robot.joints:
        yield f"[sites.{joint.output}]"
        yield 'kind = "joint"'
        yield f'joint = "{joint.name}"'
        if joint.sprung:
            yield f'stiffness = "{joint.output}_stiffness"'
        if effort := _effort(robot, joint, terms.drives.get(joint.name)):
            yield f'load = "{effort}"'
            yield "drive = true"
    yield "[initial]"
    for joint in robot.joints:
        begins = "first" if joint.output in measured else "free"
        yield f'{joint.output} = "{begins}"'
        if start == "free":
            yield f'{joint.output}_rate = "free"'


def _effort(robot: Robot, joint: RobotJoint, drive: JointDrive | None) -> str:
    """Return the equation of what a joint's drive puts on it: the load of effects in gear and drive; "" if unknown."""
    found = [one for one in robot.actuators if one.joint == joint.name]
    if drive is None or len(found) != 1:
        return ""
    braked = f" - {drive.kv!r}*{joint.output}_rate" if drive.kv else ""
    efforts = {
        "torque": f"{drive.gear!r}*{found[0].input}",
        "geared": f"{drive.gear!r}*{found[0].input}",
        "position": f"{identifier(found[0].name)}_kp*({found[0].input} - {joint.output}){braked}",
    }
    effort = efforts.get(found[0].command, "")
    low, high = drive.limits
    return f"clip({effort}, {low!r}, {high!r})" if effort and np.isfinite([low, high]).all() else effort


def _parameters(robot: Robot, set_elsewhere: Collection[str]) -> Iterator[str]:
    names = [one.name for one in robot.joints]
    armature = dict(zip(names, robot_terms(robot.xml, names).armature, strict=True))
    added = {one.joint for one in robot.actuators if one.added}
    for joint in robot.joints:
        per = "N m s/rad" if joint.unit == "rad" else "N s/m"
        yield (
            f'{joint.output}_damping = {{ mjcf = "joint.{joint.name}.damping", tolerance = {_FREE}, '
            f'unit = "{per}", lower = 0.0 }}'
        )
        if armature[joint.name] or joint.name in added:
            tolerance = _FREE if joint.name in added else str(_MASS_TOLERANCE)
            yield (
                f'{joint.output}_armature = {{ mjcf = "joint.{joint.name}.armature", tolerance = {tolerance}, '
                f'unit = "{"kg m^2" if joint.unit == "rad" else "kg"}", lower = 0.0 }}'
            )
        if joint.sprung:
            yield (
                f'{joint.output}_stiffness = {{ mjcf = "joint.{joint.name}.stiffness", tolerance = {_GAIN_TOLERANCE}, '
                f'unit = "{"N m/rad" if joint.unit == "rad" else "N/m"}", lower = 0.0 }}'
            )
    for actuator in robot.actuators:
        if actuator.command != "position":
            continue
        tolerance = _FREE if actuator.added else str(_GAIN_TOLERANCE)
        stem, unit = identifier(actuator.name), actuator.unit
        force = "N m" if unit == "rad" else "N"
        yield (
            f'{stem}_kp = {{ mjcf = "actuator.{actuator.name}.kp", tolerance = {tolerance}, '
            f'unit = "{force}/{unit}", lower = 0.0 }}'
        )
        # of a servo's damping the motion shows no more than its sum with the joint's: one of them is enough to fit
    for name, mass in heavy_bodies(robot.xml).items():
        place = f"body.{name}.mass"
        value = f"value = {mass!r}" if place in set_elsewhere else f'mjcf = "{place}"'
        yield (
            f'{identifier(name)}_mass = {{ {value}, tolerance = {_MASS_TOLERANCE}, unit = "kg", lower = 1e-6 }}'
        )
