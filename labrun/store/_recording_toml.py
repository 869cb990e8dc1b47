"""`recording.toml`: its channels and trials, and every fault with its line."""

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, cast

from labrun.toml import KeyPath, locate, nearest

Kind = Literal["input", "output"]
Between = Literal["linear", "hold", "band-limited"]
_KINDS = ("input", "output")
_BETWEENS = ("linear", "hold", "band-limited")
_UNNUMBERED = 0
_FOLDER_NAME = re.compile(r"(?![.\s])[^/\\\x00-\x1f\x7f]+(?<![.\s])")
"""Runs are filed under the experiment's name: it is one folder, inside the results."""
_LONGEST_NAME = 120
"""Bytes; file systems take 255, and a temporary file's name is longer than what it stands for."""


@dataclass(frozen=True, slots=True)
class ChannelEntry:
    """One `[channels.NAME]` table."""

    name: str
    kind: Kind
    unit: str
    between: Between


@dataclass(frozen=True, slots=True)
class TrialEntry:
    """One `[[trials]]` table, and its line."""

    file: str
    condition: Mapping[str, float | str]
    repeat: int
    line: int


@dataclass(frozen=True, slots=True)
class Contents:
    """What `recording.toml` says; entries that have faults are left out."""

    name: str
    channels: list[ChannelEntry] = field(default_factory=list)
    trials: list[TrialEntry] = field(default_factory=list)


def read_toml(path: Path) -> tuple[Contents, list[str]]:
    """Return what the file says and every fault found in it."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        return Contents(path.parent.name), [f"{path}: not text: {error.reason} at byte {error.start}"]
    if not text.strip():
        return Contents(path.parent.name), [
            f"{path}:1: the file is empty; expected [channels.NAME] and [[trials]]"
        ]
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"at line (\d+)", str(error))
        return Contents(path.parent.name), [
            f"{path}:{place.group(1) if place else 1}: not valid TOML: {error}"
        ]
    return _Reader(path, text).read(data)


class _Reader:
    def __init__(self, path: Path, text: str) -> None:
        self._path = path
        self._positions = locate(text)
        self._faults: list[str] = []

    def read(self, data: Mapping[str, Any]) -> tuple[Contents, list[str]]:
        self._known(data, ("experiment", "channels", "trials"), (), "the file")
        folder = self._path.parent.resolve().name
        name = data.get("experiment", folder)
        if not isinstance(name, str) or not name:
            self._fault(("experiment",), f"experiment is a name in quotes, not {name!r}")
        elif not _FOLDER_NAME.fullmatch(name) or len(name.encode()) > _LONGEST_NAME:
            origin = "" if "experiment" in data else " (the folder's own, as recording.toml gives none)"
            self._fault(
                ("experiment",),
                f'experiment is {name!r}{origin}; expected the name of one folder, such as "ring-down": '
                f"no slash, backslash or control character, no point or space at either end, "
                f"at most {_LONGEST_NAME} bytes",
            )
        contents = Contents(
            str(name), self._channels(data.get("channels", {})), self._trials(data.get("trials", []))
        )
        return contents, self._faults

    def _channels(self, tables: Any) -> list[ChannelEntry]:
        where: KeyPath = ("channels",)
        if not isinstance(tables, dict) or not tables:
            self._fault(
                where, "no channels; expected a table [channels.NAME] for each column of the CSV files"
            )
            return []
        before = len(self._faults)
        entries = [
            entry for name, table in tables.items() if (entry := self._channel(name, table)) is not None
        ]
        if len(self._faults) == before and not any(entry.kind == "output" for entry in entries):
            self._fault(where, 'no channel has kind = "output": there is nothing to compare a model with')
        return entries

    def _channel(self, name: str, table: Any) -> ChannelEntry | None:
        at: KeyPath = ("channels", name)
        where = f"channels.{name}"
        if not isinstance(table, dict):
            self._fault(at, f"{where} is a table with kind and unit, not {table!r}")
            return None
        before = len(self._faults)
        if name == "time_s":
            self._fault(at, f"{where}: time_s is the first column of every file and no channel")
        self._known(table, ("kind", "unit", "between"), at, where)
        kind = self._choice(table, "kind", _KINDS, at, where)
        unit = table.get("unit")
        if not isinstance(unit, str) or not unit.strip():
            found = "is missing" if unit is None else f"is {unit!r}"
            message = (
                f'{where}: unit {found}; expected a unit in quotes, such as "rad" or "N m" ("1" for none)'
            )
            self._fault((*at, "unit"), message)
        between = self._choice(table, "between", _BETWEENS, at, where, default="linear")
        if kind == "output" and "between" in table:
            message = f"{where}: between says how an input runs between its samples; this is an output"
            self._fault((*at, "between"), message)
        if len(self._faults) > before:
            return None
        return ChannelEntry(name, cast("Kind", kind), str(unit), cast("Between", between))

    def _trials(self, tables: Any) -> list[TrialEntry]:
        if not isinstance(tables, list) or not tables:
            message = "no trials; expected a table [[trials]] with file = ... for each CSV file"
            self._fault(("trials",), message)
            return []
        found = [self._trial(table, index) for index, table in enumerate(tables)]
        entries = [entry for entry in found if entry is not None]
        self._twice_the_same_file(entries)
        return self._numbered(entries)

    def _trial(self, table: Any, index: int) -> TrialEntry | None:
        at: KeyPath = ("trials", index)
        where = f"trial {index + 1}"
        if not isinstance(table, dict):
            self._fault(at, f"{where} is a table with file and condition, not {table!r}")
            return None
        self._known(table, ("file", "repeat", "condition"), at, where)
        condition = self._condition(table.get("condition", {}), at, where)
        repeat = table.get("repeat", _UNNUMBERED)
        if "repeat" in table and (isinstance(repeat, bool) or not isinstance(repeat, int) or repeat < 1):
            self._fault((*at, "repeat"), f"{where}: repeat is {repeat!r}; expected a whole number from 1")
            repeat = _UNNUMBERED
        file = table.get("file")
        if not isinstance(file, str) or not file:
            found = "is missing" if file is None else f"is {file!r}"
            self._fault((*at, "file"), f"{where}: file {found}; expected the name of a CSV file")
            return None
        return TrialEntry(file, condition, repeat, self._line((*at, "file")))

    def _twice_the_same_file(self, entries: Sequence[TrialEntry]) -> None:
        lines: dict[str, int] = {}
        for entry in entries:
            first = lines.setdefault(entry.file, entry.line)
            if first != entry.line:
                self._fault_at(entry.line, f"{entry.file} is the file of the trial at line {first} already")

    def _numbered(self, entries: Sequence[TrialEntry]) -> list[TrialEntry]:
        """Give repeats without a number the next free one of their condition."""
        numbered = []
        taken: dict[tuple[object, ...], dict[int, int]] = {}
        for entry in entries:
            lines = taken.setdefault(tuple(sorted(entry.condition.items(), key=str)), {})
            repeat = max(lines, default=0) + 1 if entry.repeat == _UNNUMBERED else entry.repeat
            if repeat in lines:
                self._fault_at(
                    entry.line,
                    f"{entry.file} is repeat {repeat} of its condition, as is the trial at line {lines[repeat]}",
                )
            lines[repeat] = entry.line
            numbered.append(replace(entry, repeat=repeat))
        return numbered

    def _condition(self, table: Any, at: KeyPath, where: str) -> dict[str, float | str]:
        if not isinstance(table, dict):
            message = f"{where}: condition is {table!r}; expected a table such as {{ amplitude_deg = 20 }}"
            self._fault((*at, "condition"), message)
            return {}
        condition: dict[str, float | str] = {}
        for name, value in table.items():
            if isinstance(value, str):
                condition[name] = value
            elif isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                message = f"{where}: condition {name} is {value!r}; expected a finite number or a word"
                self._fault((*at, "condition", name), message)
            else:
                condition[name] = float(value)
        return condition

    def _choice(
        self,
        table: Mapping[str, Any],
        key: str,
        known: Sequence[str],
        at: KeyPath,
        where: str,
        default: str | None = None,
    ) -> str | None:
        value = table.get(key, default)
        if isinstance(value, str) and value in known:
            return value
        if value is None:
            self._fault(at, f"{where}: {key} is missing; expected one of {', '.join(known)}")
            return None
        self._fault((*at, key), f"{where}: unknown {key} {value!r}; {_nearest(str(value), known)}")
        return None

    def _known(self, table: Mapping[str, Any], known: Sequence[str], at: KeyPath, where: str) -> None:
        for key in table:
            if key not in known:
                self._fault((*at, key), f"{where} has an unknown key {key!r}; {_nearest(key, known)}")

    def _line(self, at: KeyPath) -> int:
        return self._positions.of_key(at).line

    def _fault(self, at: KeyPath, message: str) -> None:
        self._fault_at(self._line(at), message)

    def _fault_at(self, line: int, message: str) -> None:
        self._faults.append(f"{self._path}:{line}: {message}")


def _nearest(found: str, known: Sequence[str]) -> str:
    near = nearest(found, known)
    return f"did you mean {near!r}?" if near else f"expected one of {', '.join(known)}"
