"""The joints of a robot as a stored diagnosis has them: its clock, base, load and links, and the causes of each."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from labrun.effects import AttachedEffect
from labrun.gap.robot.diagnose import among
from labrun.gap.robot.diagnosis import OF_THE_LOG, OF_THE_WHOLE
from labrun.gap.robot.links import beside_encoders
from labrun.gap.robot.one_joint import OneJoint, Prescribed, one_joint
from labrun.gap.saving import effects_of


@dataclass(frozen=True)
class DiagnosedJoint:
    """A joint with its answer.

    Attributes
    ----------
    effects
        Its own causes: a base and a load belong to the whole robot.
    answer
        As `Diagnosis.to_json` gives it.
    """

    isolated: OneJoint
    effects: tuple[AttachedEffect, ...]
    answer: Mapping[str, Any]


def diagnosed_joints(known: Prescribed, diagnosis: Mapping[str, Any]) -> Iterator[DiagnosedJoint]:
    """Yield the joints of a robot, each looked at with what the diagnosis says of all others.

    Parameters
    ----------
    known
        Robot, model and data as they were diagnosed.
    diagnosis
        As `RobotDiagnosis.to_json` gives it, and as it is stored.
    """
    around = as_diagnosed(known, diagnosis)
    answers = {joint["joint"]: joint["diagnosis"] for joint in diagnosis["joints"]}
    for index, joint in enumerate(known.robot.joints):
        answer = answers[joint.name]
        own = tuple(effect for effect in effects_of(answer) if effect.effect.id not in OF_THE_WHOLE)
        yield DiagnosedJoint(one_joint(around, index), own, answer)


def as_diagnosed(known: Prescribed, diagnosis: Mapping[str, Any]) -> Prescribed:
    """Return what is prescribed with the clock, the base, the load and the links as the diagnosis has them."""
    whole = [(entry["effect"], tuple(entry["joints"]), entry["values"]) for entry in diagnosis["whole"]]
    for name, _, values in whole:
        if name in OF_THE_LOG:
            (lead_s,) = values.values()
            known = known.led(-lead_s if name == "delay" else lead_s)
    answers = {joint["joint"]: joint["diagnosis"] for joint in diagnosis["joints"]}
    joints: list[tuple[OneJoint, tuple[AttachedEffect, ...], Mapping[str, float]]] = []
    for index, joint in enumerate(known.robot.joints):
        answer = answers[joint.name]
        joints.append((one_joint(known, index), effects_of(answer), answer["corrected"]))
    return among(known.with_links(beside_encoders(known, joints)), whole)
