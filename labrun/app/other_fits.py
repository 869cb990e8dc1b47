"""Read parameters fitted by other tools: mujoco.sysid, PACE, Isaac Lab, an identified MJCF, or a table."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from labrun.errors import RequestError
from labrun.gap import FittedValue, Quantity
from labrun.models import Robot, is_robot, read_robot, robot_terms

_QUANTITIES: Mapping[str, Quantity] = {
    "armature": "armature", "damping": "damping", "viscous_friction": "damping", "viscous": "damping",
    "frictionloss": "frictionloss", "friction": "frictionloss", "static_friction": "frictionloss",
    "coulomb": "frictionloss", "dynamic_friction": "frictionloss", "stiffness": "stiffness", "kp": "kp",
    "delay": "delay", "mass": "mass",
}  # fmt: skip
"""What tools call a quantity."""
_ISAAC: Mapping[str, Quantity] = {
    "stiffness": "kp", "armature": "armature", "friction": "frictionloss", "viscous_friction": "damping",
}  # fmt: skip
"""Fields of Isaac Lab's actuator configurations; its damping is the servo's."""
_LISTS = ("joint_order", "joint_names", "joints")
_HINT = "a plain table is {joint: {armature: 0.01, damping: 0.2, frictionloss: 0.1}} as JSON or YAML"


def read_fit(path: Path, robot: Robot) -> list[FittedValue]:
    """Return the parameters of a robot that another tool fitted.

    Parameters
    ----------
    path
        ``params_x_hat.yaml`` or the identified MJCF of mujoco.sysid; a YAML or JSON file with ``joint_order`` and a
        list of each quantity (PACE), with ``actuators`` as Isaac Lab has them, or ``{joint: {quantity: number}}``.

    Raises
    ------
    RequestError
        The file cannot be read, or holds nothing of the robot.
    """
    if is_robot(path):
        return _of_robot(read_robot(path))
    table = _table(path)
    values = list(_values(table, robot))
    if not values:
        names = ", ".join(joint.name for joint in robot.joints)
        raise RequestError(f"{path} holds no number of a joint of {robot.name} ({names})", hint=_HINT)
    return values


def _of_robot(robot: Robot) -> list[FittedValue]:
    names = [joint.name for joint in robot.joints]
    terms = robot_terms(robot.xml, names)
    results = []
    for index, name in enumerate(names):
        numbers: dict[Quantity, float] = {
            "armature": terms.armature[index], "damping": terms.damping[index],
            "frictionloss": terms.friction[index], "stiffness": terms.stiffness[index],
        }  # fmt: skip
        if name in terms.drives and terms.drives[name].kp:
            numbers["kp"] = terms.drives[name].kp
        results += [FittedValue(name, quantity, float(value)) for quantity, value in numbers.items()]
    return results


def _table(path: Path) -> Mapping[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RequestError(f"{path} cannot be read: {error.strerror}") from None
    try:
        table = json.loads(text) if path.suffix == ".json" else _yaml(text)
    except ValueError as error:
        raise RequestError(f"{path} cannot be read: {error}", hint=_HINT) from None
    if not isinstance(table, dict):
        raise RequestError(f"{path} is not a table of parameters", hint=_HINT)
    return table


def _yaml(text: str) -> object:
    try:
        import yaml
    except ImportError:
        raise RequestError("YAML files need the package pyyaml", hint='pip install "labrun[sysid]"') from None
    try:
        return cast("object", yaml.safe_load(text))
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from None


def _values(table: Mapping[str, Any], robot: Robot) -> Iterator[FittedValue]:
    order = next((table[name] for name in _LISTS if isinstance(table.get(name), list)), None)
    if isinstance(table.get("actuators"), dict):
        yield from _of_isaac(table["actuators"], robot)
    elif order is not None:
        yield from _of_lists(table, [str(name) for name in order], robot)
    elif all(isinstance(entry, dict) and {"value", "nominal"} & entry.keys() for entry in table.values()):
        yield from _of_sysid(table, robot)
    else:
        elements = {*(joint.name for joint in robot.joints), *robot.bodies}
        for element, entry in table.items():
            for key, value in entry.items() if element in elements and isinstance(entry, dict) else ():
                if key in _QUANTITIES and isinstance(value, int | float):
                    yield FittedValue(element, _QUANTITIES[key], float(value))


def _of_isaac(groups: Mapping[str, Any], robot: Robot) -> Iterator[FittedValue]:
    for group in groups.values():
        patterns = group.get("joint_names_expr", [".*"])
        for joint in robot.joints:
            if not any(re.fullmatch(pattern, joint.name) for pattern in patterns):
                continue
            for key, quantity in _ISAAC.items():
                given = group.get(key)
                if isinstance(given, dict):
                    matching = (value for name, value in given.items() if re.fullmatch(name, joint.name))
                    given = next(matching, None)
                if isinstance(given, int | float):
                    yield FittedValue(joint.name, quantity, float(given))


def _of_lists(table: Mapping[str, Any], order: Sequence[str], robot: Robot) -> Iterator[FittedValue]:
    names, bounds = {joint.name for joint in robot.joints}, table.get("bounds", {})
    step_s = robot_terms(robot.xml, [joint.name for joint in robot.joints]).step_s
    for key, quantity in _QUANTITIES.items():
        given = table.get(key)
        if isinstance(given, int | float):
            given = [given] * len(order)
        for name, value in zip(order, given if isinstance(given, list) else (), strict=False):
            if name in names:
                # PACE counts a delay in steps of the simulation
                seconds = step_s if quantity == "delay" and value >= 1 else 1.0
                limits = bounds.get(key)
                yield FittedValue(name, quantity, seconds * float(value), tuple(limits) if limits else None)


def _of_sysid(table: Mapping[str, Any], robot: Robot) -> Iterator[FittedValue]:
    elements = sorted({*(joint.name for joint in robot.joints), *robot.bodies}, key=len, reverse=True)
    for name, entry in table.items():
        element = next((each for each in elements if name.startswith(each)), None)
        key = name[len(element) :].strip("_.:/ ") if element else ""
        value = _number(entry.get("value", entry.get("nominal")))
        if element is None or key not in _QUANTITIES or value is None:
            continue
        low, high = (_number(entry.get(end)) for end in ("min_value", "max_value"))
        yield FittedValue(
            element, _QUANTITIES[key], value, None if low is None or high is None else (low, high)
        )


def _number(given: object) -> float | None:
    while isinstance(given, list) and len(given) == 1:
        given = given[0]
    return float(given) if isinstance(given, int | float) else None
