"""The corrected robot on pieces of the log that its numbers were not fitted to, and what of it is worth writing.

Parameters and sizes of causes are fitted again without a part of the log, joint by joint, and the whole robot is
simulated on that part: as stated, as corrected, and as the MJCF file that is written, which MuJoCo alone loads and
steps. `labrun.gap.decide` then says of each joint which correction is better than what is stated; any other is left
out.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, Note, silent
from labrun.gap.robot.as_diagnosed import diagnosed_joints
from labrun.gap.robot.correction_choice import CorrectionChoice, Written
from labrun.gap.robot.log_pieces import Pieces
from labrun.gap.robot.one_joint import prescribed
from labrun.gap.robot.together import IN_THE_ROBOT
from labrun.gap.robot.torque_units import in_torques
from labrun.gap.robot.withheld_fits import Correction, corrections
from labrun.gap.saving import effects_of
from labrun.models import Model, Robot


@dataclass(frozen=True)
class CheckedJoint:
    """Errors of one joint on pieces of the log that the fit has not seen.

    Attributes
    ----------
    stated, corrected, exported
        Root mean square of measured minus simulated, in `unit`: of the file as stated, of the corrected model, and of
        the corrected MJCF in MuJoCo. Infinite where the simulation diverges.
    corrected_as, exported_as
        What of the correction is in the model and in the file: "as stated", "causes", "parameters" or both.
    """

    joint: str
    unit: str
    stated: float
    corrected: float
    exported: float
    corrected_as: str
    exported_as: str

    def to_json(self) -> dict[str, str | float | None]:
        """Return the fields by name; an infinite error is null."""
        errors = {
            "stated": self.stated, "corrected": self.corrected, "exported": self.exported,
        }  # fmt: skip
        finite = {name: value if np.isfinite(value) else None for name, value in errors.items()}
        words = {"corrected_as": self.corrected_as, "exported_as": self.exported_as}
        return {"joint": self.joint, "unit": self.unit, **finite, **words}


@dataclass(frozen=True)
class FileCheck:
    """What a corrected robot is worth on pieces of the log that its numbers were not fitted to.

    Attributes
    ----------
    pieces
        Number of pieces of the log that were withheld in turn.
    model, file
        What goes into the corrected model, and into the MJCF file: the file leaves out a correction that MJCF cannot
        express and that is worse without the rest.
    """

    joints: tuple[CheckedJoint, ...]
    pieces: int
    model: Written
    file: Written

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> "FileCheck":
        """Return what `to_json` gave."""
        joints = []
        for joint in stored["joints"]:
            errors = {
                name: np.inf if joint[name] is None else joint[name]
                for name in ("stated", "corrected", "exported")
            }
            joints.append(CheckedJoint(**{**joint, **errors}))
        written = (Written.from_json(stored[name]) for name in ("model", "file"))
        return cls(tuple(joints), stored["pieces"], *written)

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {
            "joints": [joint.to_json() for joint in self.joints],
            "pieces": self.pieces,
            "model": self.model.to_json(),
            "file": self.file.to_json(),
        }


def check_file(
    robot: Robot, model: Model, dataset: Dataset, diagnosis: Mapping[str, Any], *, note: Note = silent
) -> FileCheck:
    """Simulate a corrected robot on pieces of the log that its numbers were not fitted to; keep what is better.

    Parameters
    ----------
    robot, model, dataset
        As they were diagnosed.
    diagnosis
        As `RobotDiagnosis.to_json` gives it, and as it is stored.

    Raises
    ------
    RequestError, FitError
        A robot or data that are not those of the diagnosis.
    """
    return withheld_check(robot, model, dataset, diagnosis, note=note).check


@dataclass(frozen=True)
class WithheldCheck:
    """A check with the errors behind it.

    Attributes
    ----------
    errors
        Of the corrected model: squared errors (n, joints) of every piece, by fits that have not seen it.
    """

    check: FileCheck
    pieces: Pieces
    errors: list[FloatArray]


def withheld_check(
    robot: Robot, model: Model, dataset: Dataset, diagnosis: Mapping[str, Any], *, note: Note = silent
) -> WithheldCheck:
    """Do what `check_file` does, and return the errors of the corrected model as well."""
    pieces = Pieces.of(robot, in_torques(dataset, diagnosis), diagnosis)
    fitted: list[list[list[Correction]]] = []
    for index, joint in enumerate(diagnosed_joints(prescribed(robot, model, pieces.dataset), diagnosis)):
        name = joint.isolated.joint.name
        note(f"fitting without parts of the log: {name}, {index + 1} of {len(robot.joints)} joints")
        released = [cause["effect"] for cause in joint.answer["causes"] if cause["kind"] == "parameter"]
        fitted.append(
            corrections(joint.isolated, joint.effects, released, joint.answer["corrected"], pieces.fold)
        )
    whole = _of_the_whole(model, diagnosis)
    note("simulating the stated, the corrected and the exported robot")
    in_model, in_file = (
        CorrectionChoice(model, pieces, fitted, whole, simulator).best()
        for simulator in (pieces.by_labrun, pieces.by_mujoco)
    )
    as_stated = pieces.errors(pieces.by_mujoco, [model] * pieces.folds)
    stated, corrected, exported = (
        pieces.rms(errors) for errors in (as_stated, in_model.errors, in_file.errors)
    )
    joints = tuple(
        CheckedJoint(
            joint.name,
            joint.unit,
            float(stated[index]),
            float(corrected[index]),
            float(exported[index]),
            fitted[index][in_model.levels[index]][-1].words,
            fitted[index][in_file.levels[index]][-1].words,
        )
        for index, joint in enumerate(robot.joints)
    )
    check = FileCheck(joints, len(pieces.dataset.trials), in_model.written, in_file.written)
    return WithheldCheck(check, pieces, in_model.errors)


def _of_the_whole(model: Model, diagnosis: Mapping[str, Any]) -> Written:
    """Return what the corrected model of a diagnosis has of the robot as a whole, and the delay of all goals."""
    names = {name for parameters in IN_THE_ROBOT.values() for name in parameters}
    values = {name: value for name, value in diagnosis["corrected"].items() if name in names and value}
    if "tip_load" not in values:  # of no load the place is none
        values = {name: value for name, value in values.items() if not name.startswith("tip_load")}
    clocks = {entry["effect"] for entry in diagnosis["whole"]} & {"delay"}
    effects = tuple(effect for effect in effects_of(diagnosis) if effect.effect.id in clocks)
    known = {parameter.name for parameter in model.parameters}
    return Written({name: value for name, value in values.items() if name in known}, effects)
