"""Export a diagnosis for simulators: the corrected MJCF, and ranges for domain randomisation."""

import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.app.diagnose_robot import robot_of
from labrun.app.fit import fit
from labrun.app.kept import NUMBERS, read_stored
from labrun.errors import RequestError
from labrun.estimate import Estimate
from labrun.fit import Note, load_dataset, silent
from labrun.gap import FileCheck, check_file, parameter_ranges, require_new
from labrun.gap import save_model as write_model
from labrun.models import Exported, MjcfRange, load_model, mjcf_of, mjcf_ranges
from labrun.report import file_check_lines
from labrun.store import find_data, is_recording, recording_name, replace_durably, saving

_ISAAC = {
    "dof_damping": ("randomize_actuator_gains", "damping_distribution_params", "joint_names"),
    "actuator_gainprm": ("randomize_actuator_gains", "stiffness_distribution_params", "joint_names"),
    "dof_frictionloss": ("randomize_joint_parameters", "friction_distribution_params", "joint_names"),
    "dof_armature": ("randomize_joint_parameters", "armature_distribution_params", "joint_names"),
    "body_mass": ("randomize_rigid_body_mass", "mass_distribution_params", "body_names"),
}
"""Isaac Lab's events (isaaclab.envs.mdp), the parameter that takes the range, and what says of whom."""
_MJLAB = {
    "dof_damping": ("dr.joint_damping", "joint_names"),
    "dof_frictionloss": ("dr.joint_friction", "joint_names"),
    "dof_armature": ("dr.joint_armature", "joint_names"),
    "jnt_stiffness": ("dr.joint_stiffness", "joint_names"),
    "body_mass": ("dr.body_mass", "body_names"),
}
"""mjlab's functions (mjlab.envs.mdp.dr, from 1.2 on), and what says of whom."""
_REMARKS = (
    "asset_cfg holds the arguments of SceneEntityCfg; call the robot as your scene does.",
    "Isaac Lab: randomize_joint_parameters draws dynamic and viscous friction from friction_distribution_params, too; "
    'with operation "abs" a torque becomes a damping of the same number, so set the viscous part afterwards.',
    "A body's inertia goes with its mass. Isaac Lab: recompute_inertia of randomize_rigid_body_mass does so. mjlab: "
    "dr.body_mass leaves the inertia as it is; dr.pseudo_inertia scales both.",
)


@dataclass(frozen=True, slots=True)
class ExportedRobot:
    """Files written for other simulators.

    Attributes
    ----------
    file
    exported
        What of the correction is in it, and what is not.
    ranges
        The file of ranges; None if it was not asked for.
    check
        What the file is worth on pieces of the log that its fit has not seen; None of a model alone, and of a body
        that was not diagnosed joint by joint.
    """

    file: Path
    exported: Exported
    ranges: Path | None = None
    check: FileCheck | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {
            "mjcf": str(self.file), "written": list(self.exported.written), "left_out": list(self.exported.left),
            "ranges": None if self.ranges is None else str(self.ranges),
            "file_check": None if self.check is None else self.check.to_json(),
        }  # fmt: skip

    def to_text(self) -> str:
        """Return the text that the terminal prints."""
        lines = [f"wrote {self.file}", *(f"  {part}" for part in self.exported.written)]
        if self.exported.left:
            lines += ["not in it:", *(f"  {part}" for part in self.exported.left)]
        if self.check is not None:
            lines += file_check_lines(self.check)
        return "\n".join([*lines, *([f"wrote {self.ranges}"] if self.ranges is not None else [])])


def export_robot(
    target: str | Path,
    file: Path,
    *,
    ranges: Path | None = None,
    results: str | Path = "results",
    note: Note = silent,
) -> ExportedRobot:
    """Write the corrected robot of a diagnosis as MJCF, and intervals of its parameters.

    Parameters
    ----------
    target
        A run or recording that was diagnosed, a ``diagnosis.json``, or a corrected model.
    file
        The MJCF file to write.
    ranges
        A JSON file with 95 % intervals, from resampled trials, of what the diagnosis fitted: as numbers of MJCF, and as
        the fields of Isaac Lab and mjlab. Fits the corrected model to the data once more, a robot's joint by joint.

    Raises
    ------
    RequestError
        There is no diagnosis, or a file is there already.
    StoreError
        A file cannot be written.
    ModelError
        The model is none of MuJoCo.
    """
    require_new(file)
    if ranges is not None:
        require_new(ranges)
    path = Path(target).expanduser()
    if path.suffix == ".toml" and path.is_file():
        if ranges is not None:
            raise RequestError(
                "ranges need data: a model alone has no intervals",
                hint="name the recording that was diagnosed",
            )
        exported = mjcf_of(load_model(path))
        _write(file, exported.xml)
        return ExportedRobot(file, exported)
    stored = _diagnosis(path, str(target), Path(results))
    source = stored.get("model_source")
    if not isinstance(source, str):
        raise RequestError("the diagnosis does not say where its model is", hint="diagnose it again")
    check = _checked(stored, source, note)
    if check is not None:
        stored = {**stored, **check.file.to_json()}
    with tempfile.TemporaryDirectory() as folder:
        corrected = Path(folder) / "corrected.toml"
        write_model(stored, source, corrected)
        model = load_model(corrected)
        exported = mjcf_of(model)
        intervals: list[MjcfRange] = []
        if ranges is not None:
            fitted = _fitted(stored, source, corrected, note)
            intervals = mjcf_ranges(
                model, {name: (estimate.value, *estimate.ci95) for name, estimate in fitted.items()}
            )
    _write(file, exported.xml)
    if ranges is not None:
        _write(ranges, json.dumps(_ranges(intervals, stored), indent=2) + "\n")
    return ExportedRobot(file, exported, ranges, check)


def _checked(stored: Mapping[str, Any], source: str, note: Note) -> FileCheck | None:
    """Return the stored errors of a corrected robot on held-out data."""
    if "joints" not in stored:
        return None
    if "file_check" in stored:
        return FileCheck.from_json(stored["file_check"])
    model, recording = load_model(source), Path(source).parent
    dataset = load_dataset(recording, model)
    return check_file(robot_of(recording, dataset), model, dataset, stored, note=note)


def _write(file: Path, text: str) -> None:
    with saving(file.name, file.absolute().parent):
        replace_durably(file, text.encode())


def _fitted(stored: Mapping[str, Any], source: str, corrected: Path, note: Note) -> Mapping[str, Estimate]:
    """Refit the corrected parameters, joint by joint if the robot was diagnosed so."""
    note("fitting the corrected model to every trial")
    if "joints" in stored:
        model, recording = load_model(source), Path(source).parent
        dataset = load_dataset(recording, model)
        return parameter_ranges(robot_of(recording, dataset), model, dataset, stored, note=note)
    # the diagnosis has fitted it: other starts would only lead back
    return fit(
        stored["source"], model=str(corrected), starts=1, results=corrected.parent, note=note
    ).parameters


def _diagnosis(path: Path, target: str, results: Path) -> Mapping[str, Any]:
    if path.name == NUMBERS and path.is_file():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    if path.is_file() and path.suffix not in (".h5", ".nc"):
        raise RequestError(
            f"{path} is neither a corrected model nor a run",
            hint="a robot's file and its log make a model: "
            "labrun gap diagnose arm.xml --log run.mcap --save-model corrected.toml",
        )
    named = find_data(target, results)
    if not is_recording(named):
        return read_stored(named)
    kept = sorted(
        (results / recording_name(named)).glob(f"gap-*/{NUMBERS}"),
        key=lambda file: file.stat().st_mtime,
        reverse=True,
    )
    moved = None
    for file in kept:
        stored = _read(file)
        source = Path(str(stored.get("source", "")))
        if source.resolve() == named.resolve():
            return stored
        # another recording may state the same name; one that is no longer there may be this one, moved
        moved = moved or (None if is_recording(source) else stored)
    if moved is not None:
        return moved
    raise RequestError(f"{target} has no diagnosis yet", hint=f"labrun gap diagnose {target} makes one")


def _read(numbers: Path) -> dict[str, Any]:
    """Return a diagnosis, empty if it cannot be read."""
    try:
        return dict(json.loads(numbers.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


def _ranges(intervals: list[MjcfRange], stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return the intervals as MJCF numbers, as events of Isaac Lab and as those of mjlab."""
    isaac, mjlab = [], []
    for interval in intervals:
        if interval.array in _ISAAC:
            event, parameter, whose = _ISAAC[interval.array]
            name = interval.joint if whose == "joint_names" and interval.joint else interval.element
            isaac.append(
                _event(event, whose, name, {parameter: [interval.low, interval.high], "operation": "abs"})
            )
        if interval.array in _MJLAB:
            event, whose = _MJLAB[interval.array]
            mjlab.append(
                _event(
                    event,
                    whose,
                    interval.element,
                    {"ranges": [interval.low, interval.high], "operation": "abs"},
                )
            )
        elif interval.array == "actuator_gainprm" and interval.value > 0.0:
            gains = {
                "kp_range": [interval.low / interval.value, interval.high / interval.value],
                "kd_range": [1.0, 1.0],
            }
            mjlab.append(
                _event("dr.pd_gains", "actuator_names", interval.element, {**gains, "operation": "scale"})
            )
    effects = [
        {"effect": cause["effect"], "site": cause["site"], "values": cause["values"]}
        for cause in stored.get("causes", [])
        if cause.get("effect")
    ]
    return {
        "interval": "95 %, from resampled trials",
        "parameters": [interval.to_json() for interval in intervals],
        "effects": effects,
        "isaac_lab": isaac,
        "mjlab": mjlab,
        "remarks": list(_REMARKS),
    }


def _event(function: str, whose: str, name: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    asset = {"name": "robot", whose: [name]}
    return {"func": function, "mode": "startup", "params": {"asset_cfg": asset, **parameters}}
