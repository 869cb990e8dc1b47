"""CSV columns of a recording: a fast way for good files, a slow one that finds every fault of bad ones."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from labrun.arrays import FloatArray
from labrun.toml import nearest

_SHOWN_PER_KIND = 3
"""A file that is wrong in one way throughout is reported by its first lines, not by all of them."""


def read_columns(
    path: Path, wanted: Sequence[str], listed_at: str
) -> tuple[Mapping[str, FloatArray] | None, list[str]]:
    """Return the wanted columns by name, or None with every fault found.

    `wanted`: column names; the first is time, which must increase from row to row. Other columns of the file are
    ignored. `listed_at`: where the file is named ("recording.toml:12"), for a file that is not there.
    """
    text, fault = _read_text(path, listed_at)
    if text is None:
        return None, [fault]
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        return None, [f"{path}:1: the file is empty; expected a header line {','.join(wanted)}"]
    header = [name.strip() for name in next(csv.reader([lines[0]]))]
    faults = _header_faults(path, header, wanted)
    if len(lines) == 1:
        faults.append(f"{path}:1: there is a header and no sample below it")
    if len(lines) == 1 or faults:
        present = [name for name in wanted if header.count(name) == 1]
        return None, faults + _row_faults(path, lines, header, present)
    table = _parse_fast(lines, header, wanted)
    if table is None:
        faults = _row_faults(path, lines, header, wanted)
        if faults:
            return None, faults
        table = _parse_slowly(lines, header, wanted)  # sound, but quoted
    return {name: np.ascontiguousarray(table[:, index]) for index, name in enumerate(wanted)}, []


def _read_text(path: Path, listed_at: str) -> tuple[str | None, str]:
    if not path.is_file():
        here = sorted(entry.name for entry in path.parent.glob("*.csv")) if path.parent.is_dir() else []
        near = nearest(path.name, here)
        return None, f"{listed_at}: the file {path} does not exist" + (
            f"; did you mean {near}?" if near else ""
        )
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data[:64]:
        return None, f"{path}:1: text in UTF-16, or no text; expected UTF-8"
    try:
        return data.decode("utf-8-sig"), ""
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        byte = data[error.start]
        return (
            None,
            f"{path}:{line}: not text in UTF-8: byte 0x{byte:02x}; if it is Windows-1252, save it as UTF-8",
        )


def _header_faults(path: Path, header: Sequence[str], wanted: Sequence[str]) -> list[str]:
    faults = [
        f"{path}:1: column {name!r} stands there twice"
        for name in dict.fromkeys(wanted)
        if header.count(name) > 1
    ]
    missing = [name for name in wanted if name not in header]
    if missing and len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        mark = "semicolons" if ";" in header[0] else "tabs"
        return [
            f"{path}:1: columns are separated by {mark}; expected commas (and a point in decimal numbers)"
        ]
    for name in missing:
        near = nearest(name, [other for other in header if other not in wanted], cutoff=0.4)
        there = (
            f"the nearest is {near!r}" if near else "there are " + ", ".join(repr(other) for other in header)
        )
        faults.append(f"{path}:1: column {name!r} is missing; {there}")
    return faults


def _parse_fast(lines: Sequence[str], header: Sequence[str], wanted: Sequence[str]) -> FloatArray | None:
    """Return the table (n, wanted), or None if anything at all is wrong with it."""
    rows = lines[1:]
    commas = len(header) - 1
    if any(row.count(",") != commas for row in rows):
        return None
    columns = [list(header).index(name) for name in wanted]
    try:
        table = np.loadtxt(
            io.StringIO("\n".join(rows)), delimiter=",", usecols=columns, comments=None, ndmin=2
        )
    except ValueError:
        return None
    sound = (
        len(table) == len(rows)
        and bool(np.all(np.isfinite(table)))
        and bool(np.all(np.diff(table[:, 0]) > 0))
    )
    return np.asarray(table, dtype=float) if sound else None


def _parse_slowly(lines: Sequence[str], header: Sequence[str], wanted: Sequence[str]) -> FloatArray:
    columns = [list(header).index(name) for name in wanted]
    rows = [_cells(line) for line in lines[1:]]
    return np.array([[float(row[column]) for column in columns] for row in rows])


def _row_faults(path: Path, lines: Sequence[str], header: Sequence[str], wanted: Sequence[str]) -> list[str]:
    """Return every fault below the header, those of one kind in one column summed up after the first few."""
    labels: dict[tuple[str, str], list[str]] = {}

    def note(kind: str, column: str, message: str) -> None:
        labels.setdefault((kind, column), []).append(message)

    columns = {name: list(header).index(name) for name in wanted}
    ends = _early_ends(lines, len(header), columns)
    for name, end in ends.items():
        note(
            "short",
            name,
            f"{path}:{end + 1}: column {name!r} ends after line {end}; the file continues to line {len(lines)}",
        )
    previous, previous_line = -math.inf, 0
    for number, line in enumerate(lines[1:], start=2):
        cells = _cells(line)
        if len(cells) != len(header):
            what = "a blank line" if not line.strip() else f"a row of {len(cells)} cells"
            note("length", "", f"{path}:{number}: {what}; the header has {len(header)} columns")
            continue
        for name, index in columns.items():
            if number > ends.get(name, len(lines)):
                continue
            value, problem = _number(cells[index])
            if problem:
                note("cell", name, f"{path}:{number}: {problem} in column {name!r}")
            elif name == "time_s":
                if value <= previous:
                    note(
                        "time",
                        name,
                        f"{path}:{number}: time_s {value:.9g} does not follow {previous:.9g} of line {previous_line}",
                    )
                previous, previous_line = value, number
    faults = []
    for messages in labels.values():
        faults += messages[:_SHOWN_PER_KIND]
        if len(messages) > _SHOWN_PER_KIND:
            faults[-1] += f" (and {len(messages) - _SHOWN_PER_KIND} more like it)"
    return faults


def _early_ends(lines: Sequence[str], width: int, columns: Mapping[str, int]) -> dict[str, int]:
    """Return the last line that has a value, for columns that are blank from there to the end of the file."""
    ends: dict[str, int] = {}
    open_columns = dict(columns)
    for number in range(len(lines), 1, -1):
        cells = _cells(lines[number - 1])
        if len(cells) != width:
            break
        for name, index in list(open_columns.items()):
            if cells[index].strip():
                del open_columns[name]
                if number < len(lines):
                    ends[name] = number
        if not open_columns:
            break
    return ends


def _cells(line: str) -> list[str]:
    return next(csv.reader([line]), [])


def _number(cell: str) -> tuple[float, str]:
    text = cell.strip()
    if not text:
        return math.nan, "a blank cell"
    try:
        value = float(text)
    except ValueError:
        return math.nan, f"{text!r} is not a number"
    # float() also takes "1_000", which no instrument writes and loadtxt refuses
    if "_" in text:
        return math.nan, f"{text!r} is not a number"
    return value, "" if math.isfinite(value) else f"{text!r} is not finite"
