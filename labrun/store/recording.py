"""A recording: `recording.toml` beside CSV files, measured by anyone. Read whole, or refused with every fault."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RecordingError
from labrun.signals import Signals
from labrun.store._recording_csv import read_columns
from labrun.store._recording_toml import Between, TrialEntry, read_toml

_SHOWN_FAULTS = 25


@dataclass(frozen=True, slots=True)
class SignalInfo:
    """One channel of a recording.

    Attributes
    ----------
    between
        How an input runs between its samples; always "linear" for an output, where it means nothing.
    reading_error
        Of an output: standard deviation of a value about the truth, where the recording states it.
    """

    name: str
    unit: str
    between: Between = "linear"
    reading_error: float | None = None


@dataclass(frozen=True, slots=True)
class RecordedTrial:
    """One trial of a recording.

    Attributes
    ----------
    condition
        Numbers and words that tell this trial from the others.
    repeat
        From 1; trials of equal condition differ in it.
    time_s : (n,)
        Strictly increasing.
    inputs : (n, k)
        In the order of the recording's `inputs`, in their units.
    outputs : (n, m)
        In the order of the recording's `outputs`, in their units.
    """

    condition: Mapping[str, float | str]
    repeat: int
    time_s: FloatArray
    inputs: FloatArray
    outputs: FloatArray
    source_file: Path

    def signals(self, recording: "Recording") -> list[Signals]:
        """Return its inputs and its outputs as signals of the devices ``input`` and ``output``."""
        rate_hz = 1 / float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 0.0
        sides = (("input", recording.inputs, self.inputs), ("output", recording.outputs, self.outputs))
        return [
            Signals(
                name,
                tuple(info.name for info in infos),
                tuple(info.unit for info in infos),
                self.time_s,
                values,
                rate_hz=rate_hz,
            )
            for name, infos, values in sides
            if infos
        ]


@dataclass(frozen=True, slots=True)
class Recording:
    """A whole recording, checked."""

    name: str
    inputs: tuple[SignalInfo, ...]
    outputs: tuple[SignalInfo, ...]
    trials: tuple[RecordedTrial, ...]
    source: Mapping[str, str] = field(default_factory=dict)
    """Where it comes from, such as ``{"kind": "solver", "program": ...}``; empty where the file does not say."""


def is_recording(folder: Path) -> bool:
    """Tell whether a folder claims to be a recording."""
    return (folder / "recording.toml").is_file()


def read_recording(folder: Path) -> Recording:
    """Read a recording, checking all of it.

    Parameters
    ----------
    folder
        The folder that holds `recording.toml` and its CSV files.

    Raises
    ------
    RecordingError
        With every fault of the recording, each with file and line: a key of `recording.toml` that is unknown,
        missing or has an impossible value; a file that is missing, empty or no text; a column that is missing (with
        the nearest name there is) or ends early; a row of another length; a cell that is blank, no number or not
        finite; time that does not increase.
    """
    folder = Path(folder)
    path = folder / "recording.toml"
    if not path.is_file():
        raise RecordingError(
            f"{folder} is not a recording: it has no recording.toml",
            hint="a recording is a folder with recording.toml and one CSV file per trial; "
            "a robot's log takes its model: labrun import LOG --model arm.xml --to recordings/arm",
        )
    contents, faults = read_toml(path)
    names = list(contents.channels)
    inputs, outputs = (
        tuple(
            SignalInfo(name, channel.unit, channel.between, channel.reading_error)
            for name, channel in contents.channels.items()
            if channel.kind == kind
        )
        for kind in ("input", "output")
    )
    trials = []
    for entry in contents.trials:
        columns, found = read_columns(folder / entry.file, ["time_s", *names], f"{path}:{entry.line}")
        faults += found
        if columns is not None:
            trials.append(_trial(entry, columns, inputs, outputs, folder / entry.file))
    if faults:
        raise RecordingError(_report(folder, faults), hint="nothing was read; the files are left as they are")
    source = {} if contents.source is None else contents.source.model_dump(exclude_none=True)
    return Recording(contents.name, inputs, outputs, tuple(trials), source)


def _trial(
    entry: TrialEntry,
    columns: Mapping[str, FloatArray],
    inputs: tuple[SignalInfo, ...],
    outputs: tuple[SignalInfo, ...],
    source_file: Path,
) -> RecordedTrial:
    time_s = columns["time_s"]

    def table(channels: tuple[SignalInfo, ...]) -> FloatArray:
        return (
            np.stack([columns[channel.name] for channel in channels], axis=1)
            if channels
            else np.empty((len(time_s), 0))
        )

    return RecordedTrial(entry.condition, entry.repeat, time_s, table(inputs), table(outputs), source_file)


def _report(folder: Path, faults: list[str]) -> str:
    number = f"{len(faults)} faults" if len(faults) > 1 else "a fault"
    shown = [f"  {fault}" for fault in faults[:_SHOWN_FAULTS]]
    if len(faults) > _SHOWN_FAULTS:
        shown.append(f"  and {len(faults) - _SHOWN_FAULTS} more")
    return "\n".join([f"recording {folder} has {number}:", *shown])


def imported_channels(experiment_toml: str) -> dict[str, Any]:
    """Return the channel tables of a run that was imported: it keeps recording.toml in place of an experiment."""
    data = tomllib.loads(experiment_toml)
    return dict(data["channels"]) if "rig" not in data and isinstance(data.get("channels"), dict) else {}


def imported_source(experiment_toml: str) -> dict[str, str]:
    """Return what a recording that was imported says of where it comes from; empty where it says nothing."""
    found = tomllib.loads(experiment_toml).get("source")
    return {key: str(value) for key, value in found.items()} if isinstance(found, dict) else {}
