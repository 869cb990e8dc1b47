"""Check a recording: read it completely and simulate its model as stated; nothing is written."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labrun.app.diagnose_robot import ROBOT, joint_by_joint, robot_of
from labrun.app.question import ask, held_against, load_held, named_model
from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.experiment import condition_key
from labrun.fit import Dataset, OutputsAlone, Problem, divergence_warnings, load_dataset
from labrun.gap import require_informative, with_sound_clocks
from labrun.logs import doubts_of_columns, doubts_of_ranges, doubts_of_trial
from labrun.models import Model
from labrun.report import aligned, counted, short_time_text
from labrun.store import Recording, SignalInfo, find_data, is_recording, read_recording

_TURNED_TOO_FAR = 2.2 * math.pi
"""An angle in rad beyond 1.1 turns may be one in degrees; logs of robots are asked the same."""
_DEGREES = 400.0
_ANGLES = ("rad", "deg")
_SLOWEST_S = 5.0
"""Whole numbers, and times of angles, that step by more seconds are milliseconds more often."""
_STILL, _STILL_RAD = 0.01, 0.02
"""A joint stands still if it varies by less than this part of its range, or by less rad (m) where it has none."""
_FAR_OFF = 3.0
"""A model is far from what was measured where it misses more than so many times what that varies by."""


@dataclass(frozen=True, slots=True)
class CheckedRecording:
    """Contents of a recording, and doubts to clear before it is fitted or diagnosed.

    Attributes
    ----------
    model
        The model that it was held against; "" if none is named.
    off
        Of each output, root mean square of measured minus simulated as stated, and of measured less its mean.
    remarks
        What is doubtful, sentences with their places.
    next
        What to type.
    """

    folder: Path
    recording: Recording
    model: str
    off: dict[str, tuple[float, float]]
    remarks: tuple[str, ...]
    next: str

    @property
    def conditions(self) -> dict[object, int]:
        """How often each condition was measured."""
        conditions: dict[object, int] = {}
        for trial in self.recording.trials:
            key = condition_key(trial.condition)
            conditions[key] = conditions.get(key, 0) + 1
        return conditions

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun check --json`` prints of a recording."""
        return {
            "recording": str(self.folder),
            "trials": len(self.recording.trials),
            "conditions": len(self.conditions),
            "fewest_repeats": min(self.conditions.values()),
            "channels": [
                {"name": name, "kind": kind, "unit": unit, "lowest": low, "highest": high}
                for name, kind, unit, low, high in _channels(self.recording)
            ],
            "model": self.model or None,
            "off_as_stated": {name: offset[0] for name, offset in self.off.items()},
            "remarks": list(self.remarks),
            "next": self.next,
        }

    def to_text(self) -> str:
        """Return the text that the terminal prints."""
        trials, repeats = self.recording.trials, sorted(self.conditions.values())
        lasting = short_time_text(sum(float(trial.time_s[-1] - trial.time_s[0]) for trial in trials))
        times = f"{repeats[0]}" if repeats[0] == repeats[-1] else f"{repeats[0]} to {repeats[-1]}"
        each = "none of them repeated" if repeats[-1] == 1 else f"each measured {times} times"
        samples = lasting if lasting != "0 s" else "values without a course in time"
        lines = [
            f"{self.folder} is a recording: {counted(len(trials), 'trial')}, {samples}",
            f"{counted(len(repeats), 'condition')}, {each}",
        ]
        rows = [
            [f"  {name}", kind, unit, f"{low:.4g} to {high:.4g}"]
            for name, kind, unit, low, high in _channels(self.recording)
        ]
        lines += aligned(rows)
        if self.model:
            lines.append(f"held against {self.model} as stated, before any fit")
            lines += [
                f"  {name} is off by {off:.3g} RMS; measured, it varies by {spread:.3g} RMS"
                for name, (off, spread) in self.off.items()
            ]
        return "\n".join([*lines, *(f"note   {remark}" for remark in self.remarks), f"next   {self.next}"])


def check_recording(target: str | Path, *, model: str | Path | None = None) -> CheckedRecording:
    """Read a recording as fits and diagnoses do, and report its contents, faults and the next step.

    Parameters
    ----------
    target
        Its folder, its recording.toml, or its name.
    model
        What to hold it against; its own model.toml if None. Without one only the recording is checked.

    Raises
    ------
    RecordingError
        It cannot be read, with every fault; or it says nothing about any model.
    RequestError, ModelError
        A channel, unit or condition that the model wants and the recording does not have.
    """
    given = Path(target).expanduser()
    folder = given.parent if given.suffix == ".toml" else given
    if not is_recording(folder) and not folder.is_dir():
        folder = find_data(target, Path("results"))
    recording = read_recording(folder)
    if model is None and not (folder / "model.toml").is_file():
        data, remarks = checked_trials(
            load_dataset(folder, OutputsAlone(recording.outputs, recording.inputs))
        )
        return CheckedRecording(
            folder,
            recording,
            "",
            {},
            (*doubts(recording), *remarks, "no model.toml beside it: only the recording was checked"),
            f"labrun fit {folder} --model FILE, or labrun check {folder} --model FILE",
        )
    loaded, signals = held_against(folder, None if model is None else named_model(model, Path()), Path())
    data, remarks = checked_trials(load_held(folder, loaded, signals))
    off, messages = _held(loaded, data)
    named = "" if model is None else f" --model {model}"
    return CheckedRecording(
        folder,
        recording,
        loaded.name,
        off,
        (*doubts(recording), *remarks, *messages, *_of_robot(folder, model, data)),
        f"labrun gap diagnose {folder}{named}",
    )


def require_near(target: str | Path, *, results: str | Path = "results") -> None:
    """Raise RequestError if the error of a joint, simulated as stated, far exceeds its motion.

    A wrong unit, sign or column explains that more often than physics that is missing. Joints driven by a torque are
    not looked at: nothing holds a simulated robot where the measured one was.
    """
    try:
        folder = find_data(target, Path(results))
    except RequestError:
        return  # the diagnosis itself says that it does not exist
    if not (folder / ROBOT).is_file() or not (folder / "model.toml").is_file():
        return
    question = ask(folder, None)
    robot = robot_of(folder, question.dataset)
    goals = {actuator.joint for actuator in robot.actuators if actuator.command in ("position", "velocity")}
    if not goals:
        return
    still = {
        joint.output: _STILL * (joint.range[1] - joint.range[0]) if joint.range else _STILL_RAD
        for joint in robot.joints
        if joint.name in goals
    }
    off, _ = _held(question.model, question.dataset)
    far = [
        f"{name} is simulated {missed / spread:.2g} times as far off as it moves"
        for name, (missed, spread) in off.items()
        if spread > still.get(name, math.inf) and missed > _FAR_OFF * spread
    ]
    if far:
        raise RequestError(
            f"{'; '.join(far)}: a wrong unit, sign, zero or column explains that more often than physics",
            hint=f"labrun check {folder} shows each joint; --anyway diagnoses it as it is",
        )


def _channels(recording: Recording) -> Iterator[tuple[str, str, str, float, float]]:
    """Yield name, kind, unit and range of every channel."""
    for kind, infos in (("input", recording.inputs), ("output", recording.outputs)):
        for index, info in enumerate(infos):
            tables = [trial.inputs if kind == "input" else trial.outputs for trial in recording.trials]
            values = np.concatenate([table[:, index] for table in tables])
            yield info.name, kind, info.unit, float(np.min(values)), float(np.max(values))


def checked_trials(data: Dataset) -> tuple[Dataset, tuple[str, ...]]:
    """Return the trials that can be fitted, and remarks on their clocks.

    Raises
    ------
    RecordingError
        An output does not move, or time jumps in every trial.
    """
    require_informative(data)
    checked = with_sound_clocks(data)
    excluded = len(data.trials) - len(checked.dataset.trials)
    return (
        replace(checked.dataset, left_out=data.left_out + excluded),
        (*checked.limitations, *checked.notes),
    )


def doubts(recording: Recording) -> Iterator[str]:
    """Yield doubts that the values of a recording raise."""
    for name, kind, unit, low, high in _channels(recording):
        if unit == "rad" and _TURNED_TOO_FAR < max(-low, high) < _DEGREES:
            yield f"{name} is said to be in rad and reaches {max(-low, high):.4g}: is it in degrees?"
        if kind == "input" and low == high:
            yield f"{name} is {low:.4g} throughout: nothing was commanded, or another column was meant"
    steps = [float(np.median(np.diff(trial.time_s))) for trial in recording.trials if len(trial.time_s) > 2]
    whole = all(bool(np.all(trial.time_s == np.round(trial.time_s))) for trial in recording.trials)
    turning = any(info.unit in _ANGLES for info in (*recording.inputs, *recording.outputs))
    if steps and (whole or turning) and min(steps) > _SLOWEST_S:
        yield f"time_s steps by {min(steps):.4g} s: are they milliseconds, or less?"
    places: dict[str, list[str]] = {}
    for trial in recording.trials:
        inputs, outputs = _by_name(recording.inputs, trial.inputs), _by_name(recording.outputs, trial.outputs)
        for text, where_in_trial in doubts_of_trial(trial.source_file.name, trial.time_s, inputs, outputs):
            places.setdefault(text, []).append(where_in_trial)
    for text, where in places.items():
        more = f" and in {len(where) - 3} more places" if len(where) > 3 else ""
        yield f"{text} ({'; '.join(where[:3])}{more})"
    known = {"time_s", *(info.name for info in (*recording.inputs, *recording.outputs))}
    yield from doubts_of_columns(recording.trials[0].source_file, known)


def _by_name(infos: Sequence[SignalInfo], values: FloatArray) -> dict[str, tuple[str, FloatArray]]:
    return {info.name: (info.unit, values[:, index]) for index, info in enumerate(infos)}


def _held(model: Model, data: Dataset) -> tuple[dict[str, tuple[float, float]], list[str]]:
    """Simulate every trial as stated; return the error of each output, and remarks."""
    problem = Problem.of(model, data)
    try:
        simulated = problem.simulated(problem.begin())
    except FitError as error:
        return {}, [f"{error.args[0]} as it is stated: {error.hint}"]
    off, warnings = {}, divergence_warnings(problem, problem.begin())
    for index, output in enumerate(data.outputs):
        measured = np.concatenate([trial.outputs[:, index] for trial in data.trials])
        missed = float(np.sqrt(np.mean(np.square(measured - np.concatenate(simulated)[:, index]))))
        spread = float(np.std(measured))
        off[output.name] = (missed, spread)
        if missed > _FAR_OFF * spread and not any("diverges" in warning for warning in warnings):
            warnings.append(
                f"{output.name} is simulated {missed / spread:.2g} times as far off as it moves: look at units, "
                "signs and beginnings first, and whether only a controller, which the model has not, kept it there"
            )
    return off, warnings


def _of_robot(folder: Path, model: str | Path | None, data: Dataset) -> list[str]:
    """Return which joints leave their range in the robot's file, and how the robot would be diagnosed."""
    reason = None if model is not None else joint_by_joint(folder)
    if reason is None:
        return []
    ranges = {joint.output: joint.range for joint in robot_of(folder, data).joints}
    values = np.concatenate([trial.outputs for trial in data.trials])
    how = f"a robot, diagnosed as a whole: {reason}" if reason else "a robot, diagnosed joint by joint"
    return [*doubts_of_ranges(_by_name(data.outputs, values), ranges), how]
