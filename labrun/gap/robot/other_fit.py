"""Parameters that another tool fitted to the log of a robot, judged by the rule: which hold, and which stand in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, SiteKind, load_effect
from labrun.fit import Dataset, Note, silent
from labrun.gap import decide
from labrun.gap.diagnosis import Name
from labrun.gap.robot.correction_choice import Written
from labrun.gap.robot.file_check import withheld_check
from labrun.models import Model, Robot, identifier, robot_terms

Quantity = Literal["armature", "damping", "frictionloss", "stiffness", "kp", "delay", "mass"]
Judgement = Literal["holds", "stands in", "not asked for", "not applied"]
_SAME = 0.02
"""Part of a stated value by which a fitted one may differ and still counts as not moved."""
_AT_BOUND = 0.01
"""Part of the range between its bounds within which a fitted value counts as at its bound."""
_NEARER = 0.5
"""Part of a parameter's move that the correction must take back for the parameter to stand in for something else."""


@dataclass(frozen=True)
class FittedValue:
    """A number that another tool found.

    Attributes
    ----------
    element
        A joint, or a body of a mass.
    value
        SI; a delay in seconds.
    bounds
        What the tool was allowed; None where it does not say.
    """

    element: str
    quantity: Quantity
    value: float
    bounds: tuple[float, float] | None = None

    @property
    def at_bound(self) -> bool:
        """Whether it ended at the end of what the tool was allowed."""
        if self.bounds is None:
            return False
        low, high = self.bounds
        return min(self.value - low, high - self.value) <= _AT_BOUND * (high - low)


@dataclass(frozen=True)
class JudgedValue:
    """What the rule says of a fitted number.

    Attributes
    ----------
    stated
        What the robot's file says; None where that cannot be told.
    instead
        What it stands in for, in words.
    without
        Root mean square error of the joint with this number as stated, all others as fitted; NaN of masses.
    """

    fitted: FittedValue
    stated: float | None
    judgement: Judgement
    instead: str = ""
    without: float = float("nan")

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {
            "element": self.fitted.element, "quantity": self.fitted.quantity, "value": self.fitted.value,
            "stated": self.stated, "judgement": self.judgement, "instead": self.instead,
            "at_bound": self.fitted.at_bound, "without": self.without if np.isfinite(self.without) else None,
        }  # fmt: skip


@dataclass(frozen=True)
class JudgedJoint:
    """Errors of a joint, root mean square of measured minus simulated, by three models.

    Attributes
    ----------
    stated, fitted, corrected
        By the robot's file, by the other tool's numbers, and by what the diagnosis says, each part of the log by a fit
        that has not seen it. What the other tool has seen is not known: it may have been fitted to all of the log.
    """

    joint: str
    unit: str
    stated: float
    fitted: float
    corrected: float

    def to_json(self) -> dict[str, str | float]:
        """Return the fields by name."""
        return {
            "joint": self.joint, "unit": self.unit, "stated": self.stated, "fitted": self.fitted,
            "corrected": self.corrected,
        }  # fmt: skip


@dataclass(frozen=True)
class OtherFit:
    """Another tool's numbers, judged."""

    joints: tuple[JudgedJoint, ...]
    values: tuple[JudgedValue, ...]
    remarks: tuple[str, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {
            "joints": [joint.to_json() for joint in self.joints],
            "values": [value.to_json() for value in self.values],
            "remarks": list(self.remarks),
        }


def judge_fit(
    robot: Robot,
    model: Model,
    dataset: Dataset,
    diagnosis: Mapping[str, Any],
    values: Sequence[FittedValue],
    *,
    note: Note = silent,
) -> OtherFit:
    """Say which numbers of another fit the log asks for, and which stand in for a cause that the diagnosis names.

    Parameters
    ----------
    robot, model, dataset
        As they were diagnosed.
    diagnosis
        As `RobotDiagnosis.to_json` gives it.
    values
        What the other tool found.

    Raises
    ------
    RequestError, FitError
        A robot or data that are not those of the diagnosis.
    """
    withheld = withheld_check(robot, model, dataset, diagnosis, note=note)
    pieces, correction = withheld.pieces, withheld.check.model
    stated = _stated(robot, model)
    usable = [each for each in values if _applied(robot, model, stated, [each]) is not None]
    note("simulating the robot with the numbers of the other fit")

    def errors(chosen: Sequence[FittedValue]) -> list[FloatArray]:
        written = _applied(robot, model, stated, chosen) or Written({}, ())
        changed = model.with_values(written.values).with_effects(written.effects)
        return pieces.errors(pieces.by_mujoco, [changed] * pieces.folds)

    before, fitted = errors([]), errors(usable)
    squares = (before, fitted, withheld.errors)
    logs = [pieces.log_errors(square) for square in squares]
    names = [joint.name for joint in robot.joints]
    better = {
        name: decide.beats(logs[2][index], logs[1][index], pieces.strata) for index, name in enumerate(names)
    }
    judged = []
    for each in values:
        known = stated.get((each.element, each.quantity))
        if each not in usable:
            judged.append(JudgedValue(each, known, "not applied"))
            continue
        if known is not None and abs(each.value - known) <= _SAME * abs(known):
            continue
        without = errors([other for other in usable if other is not each])
        after = pieces.log_errors(without)
        joints_asked = [names.index(each.element)] if each.element in names else range(len(names))
        asked = any(decide.beats(logs[1][index], after[index], pieces.strata) for index in joints_asked)
        instead = _instead(each, known, robot, correction, diagnosis) if _any(better, each, names) else ""
        judgement: Judgement = "stands in" if instead else "holds" if asked else "not asked for"
        error = float(pieces.rms(without)[joints_asked[0]]) if each.element in names else float("nan")
        judged.append(JudgedValue(each, known, judgement, instead, error))
    rms = [pieces.rms(square) for square in squares]
    joints = tuple(
        JudgedJoint(joint.name, joint.unit, *(float(error[index]) for error in rms))
        for index, joint in enumerate(robot.joints)
    )
    return OtherFit(joints, tuple(judged))


def _any(better: Mapping[str, bool], value: FittedValue, names: Sequence[str]) -> bool:
    return better[value.element] if value.element in names else any(better.values())


def _instead(
    value: FittedValue, stated: float | None, robot: Robot, correction: Written, diagnosis: Mapping[str, Any]
) -> str:
    """Return the causes of its joint that a number stands in for, where their correction takes the number back."""
    outputs = {joint.name: joint.output for joint in robot.joints}
    causes = []
    for joint in diagnosis["joints"]:
        if value.quantity != "mass" and joint["joint"] != value.element:
            continue
        causes += [
            Name(cause["effect"], cause["site"], cause["kind"]).words
            for cause in joint["diagnosis"]["causes"]
            if not _is_the_same(value, cause, outputs)
        ]
    causes += [
        entry["effect"].replace("-", " ")
        for entry in diagnosis["whole"]
        if entry["effect"] != _EFFECT.get(value.quantity)
    ]
    if not causes:
        return ""
    now = correction.values.get(_parameter(robot, value), stated)
    if value.quantity in _EFFECT:
        sizes = {
            effect.site: effect.values[0]
            for effect in correction.effects
            if effect.effect.id == _EFFECT[value.quantity]
        }
        now = (stated or 0.0) + sizes.get(_site(robot, value), 0.0)
    if now is None or stated is None:
        return ""
    kept = abs(value.value - now) <= _NEARER * abs(value.value - stated)
    return "" if kept else " and ".join(dict.fromkeys(causes))


_EFFECT: Mapping[str, str] = {"frictionloss": "coulomb-friction", "delay": "delay"}


def _is_the_same(value: FittedValue, cause: Mapping[str, Any], outputs: Mapping[str, str]) -> bool:
    if cause["kind"] == "parameter":
        return bool(
            cause["effect"] == f"{outputs.get(value.element, identifier(value.element))}_{value.quantity}"
        )
    return bool(cause["effect"] == _EFFECT.get(value.quantity))


def _site(robot: Robot, value: FittedValue) -> str:
    if value.quantity == "delay":
        return next((drive.input for drive in robot.actuators if drive.joint == value.element), "")
    return next((joint.output for joint in robot.joints if joint.name == value.element), "")


def _parameter(robot: Robot, value: FittedValue) -> str:
    """Return what a number is called among the parameters of the model."""
    if value.quantity == "mass":
        return f"{identifier(value.element)}_mass"
    if value.quantity == "kp":
        drive = next((drive.name for drive in robot.actuators if drive.joint == value.element), "")
        return f"{identifier(drive)}_kp"
    output = next((joint.output for joint in robot.joints if joint.name == value.element), "")
    return f"{output}_{value.quantity}"


def _stated(robot: Robot, model: Model) -> dict[tuple[str, str], float]:
    """Return what the robot's file says of every joint and body."""
    names = [joint.name for joint in robot.joints]
    terms = robot_terms(robot.xml, names)
    values: dict[tuple[str, str], float] = {}
    for index, name in enumerate(names):
        values[name, "armature"] = float(terms.armature[index])
        values[name, "damping"] = float(terms.damping[index])
        values[name, "frictionloss"] = float(terms.friction[index])
        values[name, "stiffness"] = float(terms.stiffness[index])
        values[name, "delay"] = 0.0
        if name in terms.drives:
            values[name, "kp"] = terms.drives[name].kp
    parameters = {parameter.name: parameter.value for parameter in model.parameters}
    for body in robot.bodies:
        if f"{identifier(body)}_mass" in parameters:
            values[body, "mass"] = parameters[f"{identifier(body)}_mass"]
    return values


def _applied(
    robot: Robot, model: Model, stated: Mapping[tuple[str, str], float], values: Sequence[FittedValue]
) -> Written | None:
    """Return parameters and effects by which a model has these numbers; None where it cannot have one of them."""
    known = {parameter.name for parameter in model.parameters}
    numbers: dict[str, float] = {}
    effects: list[AttachedEffect] = []
    for value in values:
        if (value.element, value.quantity) not in stated:
            return None
        more, name = value.value - stated[value.element, value.quantity], _parameter(robot, value)
        if value.quantity == "frictionloss" and more > 0.0:
            effects.append(_attached("coulomb-friction", "joint", _site(robot, value), {"torque": more}))
        elif value.quantity == "delay" and more > 0.0 and _site(robot, value):
            effects.append(_attached("delay", "input", _site(robot, value), {"delay": more}))
        elif name in known:
            numbers[name] = value.value
        elif value.quantity == "armature":
            effects.append(_attached("added-inertia", "joint", _site(robot, value), {"inertia": more}))
        elif more:
            return None
    return Written(numbers, tuple(effects))


def _attached(name: str, kind: SiteKind, site: str, sizes: Mapping[str, float]) -> AttachedEffect:
    """Return an effect with these sizes; MJCF, which simulates it, has no word for its other parameters."""
    return load_effect(name, kind).attach(site, **sizes)
