"""Write the model file of a robot: joints are outputs and sites, actuators inputs, with base tilt and payload."""

from collections.abc import Collection, Iterator, Mapping
from typing import Any, Literal

import numpy as np

from labrun.models.mjcf.inverse import JointDrive, RobotTerms, far_end, robot_terms, tip_body
from labrun.models.mjcf.plant import imported
from labrun.models.mjcf.robot import Robot, RobotJoint, identifiers

ROLL, PITCH, LOAD, HELD = "base_roll", "base_pitch", "tip_load", "gravity_compensation"
"""Parameters of the model file: rad about x, rad about y, kg, share of all weights that the controller holds."""
PLACE = ("tip_load_x", "tip_load_y", "tip_load_z")
"""Where the load is in the frame of the last body, m: at its far end unless somebody knows better."""
_LEAST_MASS = 0.1
"""Part of the last body's mass that a load below zero leaves of it."""


def around(xml: str, masses: Mapping[str, str]) -> tuple[list[str], dict[str, str]]:
    """Return the tilt of a robot's base, the load at its tip, and inertias in proportion to the masses.

    A body that is heavier than stated and turns as easily as before would be another shape; joint by joint, a
    body counts in proportion to its mass, too.

    Parameters
    ----------
    xml
        MJCF without other files.
    masses : body -> parameter
        Which parameters are masses; that of the last body is given its value here.

    Returns
    -------
    list, dict
        Lines of ``[parameters]``; entries of ``[mjcf]``: reference -> equation.
    """
    mujoco = imported()
    model = mujoco.MjModel.from_xml_string(xml)
    parameters: list[str] = []
    equations: dict[str, str] = {}
    if not np.any(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE) and np.any(model.opt.gravity):
        parameters += [
            f'{name} = {{ value = 0.0, tolerance = 0.0, unit = "rad", lower = -1.6, upper = 1.6 }}'
            for name in (ROLL, PITCH)
        ]
        equations |= _gravity([float(component) for component in model.opt.gravity])
        if masses:  # bodies without a name, and those without a mass, cannot be held
            parameters.append(f"{HELD} = {{ value = 0.0, tolerance = 0.0, lower = -1.2, upper = 1.2 }}")
            equations |= {
                f"body.{name}.gravcomp": f"{float(model.body_gravcomp[model.body(name).id])!r} + {HELD}"
                for name in masses
            }
    for name, mass_of in masses.items():
        equations |= _in_proportion(model, name, mass_of)
    body = tip_body(model)
    name = (mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or "") if body else ""
    # MuJoCo keeps a body that is balanced about its joint so: nothing can hang on it
    if name in masses and not model.body_simple[body]:
        mass = float(model.body_mass[body])
        low = (_LEAST_MASS - 1.0) * mass
        parameters.append(f'{LOAD} = {{ value = 0.0, tolerance = 0.0, unit = "kg", lower = {low!r} }}')
        parameters += [
            f'{parameter} = {{ value = {float(value)!r}, tolerance = 0.0, unit = "m" }} # twice as far as its centre'
            for parameter, value in zip(PLACE, far_end(model), strict=True)
        ]
        equations |= _loaded(model, body, name, masses[name])
    return parameters, equations


def _gravity(down: list[float]) -> dict[str, str]:
    """Return gravity as a base sees it that is pitched about y, then rolled about x."""
    x, y, z = (repr(component) for component in down)
    after = f"(sin({PITCH})*({x}) + cos({PITCH})*({z}))"
    return {
        "option.gravity[0]": f"cos({PITCH})*({x}) - sin({PITCH})*({z})",
        "option.gravity[1]": f"cos({ROLL})*({y}) + sin({ROLL})*{after}",
        "option.gravity[2]": f"cos({ROLL})*{after} - sin({ROLL})*({y})",
    }


def _in_proportion(model: Any, name: str, mass: str) -> dict[str, str]:
    """Return the equations of a body's principal inertias, in proportion to its mass."""
    body = model.body(name)
    ratios = [float(component) / float(body.mass[0]) for component in body.inertia]
    return {f"body.{name}.inertia[{axis}]": f"{ratio!r}*{mass}" for axis, ratio in enumerate(ratios) if ratio}


def _loaded(model: Any, body: int, name: str, mass: str) -> dict[str, str]:
    """Return mass, centre and inertia of a body with a point mass on it.

    Parallel axes (Siciliano, Sciavicco, Villani, Oriolo, Robotics (2009), section B.2). Products of inertia in the
    body's principal axes are left out: none arise where the line from its centre to the load lies on one of them.
    """
    mujoco = imported()
    centre = [float(component) for component in model.body_ipos[body]]
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    to_principal = turn.reshape(3, 3).T
    expressions = {f"body.{name}.mass": f"{mass} + {LOAD}"}
    share = f"{LOAD}/({mass} + {LOAD})"
    away = [f"({coordinate} - {at!r})" for coordinate, at in zip(PLACE, centre, strict=True)]
    for axis in range(3):
        expressions[f"body.{name}.ipos[{axis}]"] = f"{centre[axis]!r} + {away[axis]}*{share}"
        along = [
            f"{float(part)!r}*{text}" for part, text in zip(to_principal[axis], away, strict=True) if part
        ]
        own = float(model.body_inertia[body, axis] / model.body_mass[body])
        squares = " + ".join(f"{text}^2" for text in away)
        expressions[f"body.{name}.inertia[{axis}]"] = (
            f"{own!r}*{mass} + ({squares} - ({' + '.join(along)})^2)*{mass}*{share}"
        )
    return expressions


def heavy_bodies(xml: str) -> dict[str, float]:
    """Return the masses of the bodies that hang on joints of their own, by name."""
    mujoco = imported()
    model = mujoco.MjModel.from_xml_string(xml)
    names = {body: mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) for body in range(1, model.nbody)}
    return {
        name: float(model.body_mass[body])
        for body, name in names.items()
        if name and model.body_mass[body] > 0 and model.body_dofnum[body] > 0
    }


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
    for actuator in robot.actuators:
        between = "hold" if actuator.command in ("position", "velocity") else "linear"
        link = f'mjcf = "actuator.{actuator.name}", unit = "{actuator.unit}", between = "{between}"'
        yield f"{actuator.input} = {{ {link} }}"
    terms = robot_terms(robot.xml, [joint.name for joint in robot.joints])
    parameters, equations = around(
        robot.xml, {body: f"{stem}_mass" for body, stem in identifiers(heavy_bodies(robot.xml)).items()}
    )
    yield "[parameters]"
    yield from _parameters(robot, terms, equations)
    yield from parameters
    yield "[mjcf]"
    if any(".inertia[" in reference for reference in equations):
        yield "# a body's inertia grows in proportion to its mass: the shape stays, the density changes"
    for reference, equation in equations.items():
        yield f'"{reference}" = "{equation}"'
    yield "[outputs]"
    for joint in (candidate for candidate in robot.joints if candidate.output in measured):
        yield f'{joint.output} = {{ mjcf = "joint.{joint.name}.position", unit = "{joint.unit}" }}'
    for name, (reference, unit) in shown.items():
        yield f'{name} = {{ mjcf = "{reference}", unit = "{unit}" }}'
    for joint in robot.joints:
        yield f"[sites.{joint.output}]"
        yield 'kind = "joint"'
        yield f'joint = "{joint.name}"'
        if joint.sprung:
            yield f'stiffness = "{joint.output}_stiffness"'
        if effort := _effort(robot, joint, _only_drive(robot, terms, joint.name)):
            yield f'load = "{effort}"'
            yield "drive = true"
    yield "[initial]"
    for joint in robot.joints:
        begins = "first" if joint.output in measured else "free"
        yield f'{joint.output} = "{begins}"'
        if start == "free":
            yield f'{joint.output}_rate = "free"'


def _only_drive(robot: Robot, terms: RobotTerms, joint: str) -> JointDrive | None:
    """Return the drive of a joint; None where it has none, or several."""
    return (
        terms.drives.get(joint) if sum(actuator.joint == joint for actuator in robot.actuators) == 1 else None
    )


def _stems(robot: Robot) -> dict[str, str]:
    """Return what the parameters of each actuator are called after."""
    return identifiers(actuator.name for actuator in robot.actuators)


def _effort(robot: Robot, joint: RobotJoint, drive: JointDrive | None) -> str:
    """Return the equation of the drive's torque on a joint, the load of effects in gear and drive; "" if unknown."""
    if drive is None:
        return ""
    actuator = next(candidate for candidate in robot.actuators if candidate.joint == joint.name)
    braked = f" - {drive.kv!r}*{joint.output}_rate" if drive.kv else ""
    efforts = {
        "torque": f"{drive.gear!r}*{actuator.input}",
        "geared": f"{drive.gear!r}*{actuator.input}",
        "position": f"{_stems(robot)[actuator.name]}_kp*({actuator.input} - {joint.output}){braked}",
    }
    effort = efforts.get(actuator.command, "")
    low, high = drive.limits
    return f"clip({effort}, {low!r}, {high!r})" if effort and np.isfinite([low, high]).all() else effort


def _parameters(robot: Robot, terms: RobotTerms, set_elsewhere: Collection[str]) -> Iterator[str]:
    names = [joint.name for joint in robot.joints]
    armature = dict(zip(names, terms.armature, strict=True))
    added = {actuator.joint for actuator in robot.actuators if actuator.added}
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
        stem, unit = _stems(robot)[actuator.name], actuator.unit
        force = "N m" if unit == "rad" else "N"
        yield (
            f'{stem}_kp = {{ mjcf = "actuator.{actuator.name}.kp", tolerance = {tolerance}, '
            f'unit = "{force}/{unit}", lower = 0.0 }}'
        )
        drive = _only_drive(robot, terms, actuator.joint)
        if drive is not None and drive.kv:
            yield (
                f"# its kv of {drive.kv:g} stays: motion shows no more than its sum with the joint's damping, "
                "which is fitted for both"
            )
    masses = heavy_bodies(robot.xml)
    stems = identifiers(masses)
    for name, mass in masses.items():
        text = f"body.{name}.mass"
        value = f"value = {mass!r}" if text in set_elsewhere else f'mjcf = "{text}"'
        yield (
            f'{stems[name]}_mass = {{ {value}, tolerance = {_MASS_TOLERANCE}, unit = "kg", lower = 1e-6 }}'
        )
