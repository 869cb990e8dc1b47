"""A recording: `recording.toml` beside CSV files, measured by anyone. Read whole, or refused with every fault."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from labrun.arrays import FloatArray
from labrun.errors import RecordingError
from labrun.signals import Signals
from labrun.store._recording_csv import read_columns
from labrun.toml import Fault, KeyPath, Places, Table, TableFaults, locate, mend, parsed, text_of

Between = Literal["linear", "hold", "band-limited"]
_FOLDER_NAME = re.compile(r"(?![.\s])[^/\\\x00-\x1f\x7f]+(?<![.\s])")
"""Runs are filed under the experiment's name: it is one folder, inside the results."""
_LONGEST_NAME = 120
"""Bytes; file systems take 255, and a temporary file's name is longer than what it stands for."""


class ChannelTable(Table):
    """One `[channels.NAME]` table; `unit` is "1" for none.

    `reading_error` is the standard deviation of a value about the truth, in the channel's unit.
    """

    kind: Literal["input", "output"]
    unit: Annotated[str, Field(pattern=r"\S")]
    between: Between = "linear"
    reading_error: PositiveFloat | None = None

    @model_validator(mode="after")
    def _says_what_fits_its_kind(self) -> "ChannelTable":
        with TableFaults() as faults:
            if self.kind == "output" and "between" in self.model_fields_set:
                faults.add("between", "says how an input runs between its samples; this is an output")
            if self.kind == "input" and self.reading_error is not None:
                faults.add("reading_error", "says how far a measured value may be off; this is an input")
        return self


class _TrialTable(Table):
    """One `[[trials]]` table."""

    file: Annotated[str, Field(min_length=1)]
    repeat: PositiveInt | None = None
    condition: dict[str, float | str] = Field(default_factory=dict)


class SourceTable(Table):
    """Where a recording comes from that no bench made."""

    kind: Literal["bench", "solver", "publication"]
    program: str | None = None
    version: str | None = None
    mesh: str | None = None
    load: str | None = None
    note: str | None = None

    @model_validator(mode="after")
    def _a_solver_is_named(self) -> "SourceTable":
        with TableFaults() as faults:
            if self.kind == "solver":
                for key in ("program", "version", "mesh", "load"):
                    if getattr(self, key) is None:
                        faults.add(key, f"is missing: what a solver gave is worth nothing without its {key}")
        return self


class _File(Table):
    """The whole file; its trials are looked at one by one, so that a fault keeps its number."""

    experiment: str | None = None
    source: SourceTable | None = None
    channels: dict[str, ChannelTable] = Field(default_factory=dict)
    trials: list[Any] = Field(default_factory=list)

    @model_validator(mode="after")
    def _says_enough(self) -> "_File":
        with TableFaults() as faults:
            if not self.channels:
                message = "no channels; expected a table [channels.NAME] for each column of the CSV files"
                faults.add("channels", message)
            elif all(channel.kind == "input" for channel in self.channels.values()):
                faults.add("channels", 'no channel has kind = "output": nothing to compare a model with')
            outputs = {name: channel for name, channel in self.channels.items() if channel.kind == "output"}
            silent = [name for name, output in outputs.items() if output.reading_error is None]
            if 0 < len(silent) < len(outputs):
                message = "has no reading_error, and other outputs do: state that of every output, or of none"
                faults.add(("channels", silent[0]), message)
            if "time_s" in self.channels:
                faults.add(("channels", "time_s"), "is the first column of every file and no channel")
            if not self.trials:
                faults.add(
                    "trials", "no trials; expected a table [[trials]] with file = ... for each CSV file"
                )
        return self


@dataclass(frozen=True, slots=True)
class TrialEntry:
    """One trial, and the line that names its file."""

    file: str
    condition: Mapping[str, float | str]
    repeat: int
    line: int


@dataclass(frozen=True, slots=True)
class Contents:
    """What `recording.toml` says; entries that have faults are left out."""

    name: str
    source: SourceTable | None = None
    channels: Mapping[str, ChannelTable] = field(default_factory=dict)
    trials: Sequence[TrialEntry] = ()


def read_toml(path: Path) -> tuple[Contents, list[str]]:
    """Return what the file says and every fault found in it."""
    folder = path.parent.resolve().name
    try:
        text = text_of(path, kind=RecordingError, what="description")
        data = parsed(text, str(path), kind=RecordingError)
    except RecordingError as error:
        return Contents(folder), [str(error)]
    file, faults = mend(_File, data)
    trials, entries = _trials(data.get("trials"), text)
    faults += entries
    name = file.experiment if file is not None and file.experiment is not None else folder
    if not _FOLDER_NAME.fullmatch(name) or len(name.encode()) > _LONGEST_NAME:
        origin = "" if "experiment" in data else f"{name!r} (the folder's own, as recording.toml gives none) "
        message = (
            f'{origin}is not the name of one folder, such as "ring-down": no slash, backslash or control '
            f"character, no point or space at either end, at most {_LONGEST_NAME} bytes"
        )
        faults.append(Fault(("experiment",), message))
    lines = [str(fault) for fault in Places(str(path), text, data).of_all(faults)]
    return Contents(
        name, None if file is None else file.source, {} if file is None else file.channels, trials
    ), lines


def _trials(tables: object, text: str) -> tuple[list[TrialEntry], list[Fault]]:
    """Return the trials that hold; those without a number are the next free repeat of their condition."""
    places = locate(text)
    entries: list[TrialEntry] = []
    faults: list[Fault] = []
    files: dict[str, int] = {}
    taken: dict[tuple[object, ...], dict[int, int]] = {}
    for index, given in enumerate(tables if isinstance(tables, list) else []):
        path: KeyPath = ("trials", index)
        if not isinstance(given, dict):
            faults.append(Fault(path, "expected a table { ... }"))
            continue
        table, wrong = mend(_TrialTable, given, path)
        faults += wrong
        if table is None:
            continue
        line = places.of_key((*path, "file")).line
        condition = {
            name: float(value) if isinstance(value, int | float) else value
            for name, value in table.condition.items()
        }
        if files.setdefault(table.file, line) != line:
            message = f"this is the file of the trial at line {files[table.file]} already"
            faults.append(Fault((*path, "file"), message, at_value=True))
        lines = taken.setdefault(tuple(sorted(condition.items(), key=str)), {})
        repeat = table.repeat or max(lines, default=0) + 1
        if repeat in lines:
            message = f"this is repeat {repeat} of its condition, as is the trial at line {lines[repeat]}"
            faults.append(Fault((*path, "file"), message, at_value=True))
        lines[repeat] = line
        entries.append(TrialEntry(table.file, condition, repeat, line))
    return entries, faults


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


def recording_name(folder: Path) -> str:
    """Return the name that a recording states; the folder's where it states none, or has faults."""
    contents, faults = read_toml(folder / "recording.toml")
    return folder.resolve().name if faults else contents.name


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
        columns, samples = read_columns(folder / entry.file, ["time_s", *names], f"{path}:{entry.line}")
        faults += samples
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
    source = tomllib.loads(experiment_toml).get("source")
    return {key: str(value) for key, value in source.items()} if isinstance(source, dict) else {}
