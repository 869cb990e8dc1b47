"""Logs in files, each by its reader: CSV, NumPy archives, HDF5, Parquet, LeRobot datasets, bags."""

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RecordingError, RequestError
from labrun.logs.ros import read_bag
from labrun.logs.streams import Column, Stream, column, vector
from labrun.toml import nearest

_TIMES = (
    "time_s", "time", "t", "timestamp", "timestamps", "stamp", "sec", "secs", "seconds", "time_ms", "time_us",
    "time_ns", "timestamp_ns", "timestamp_us", "timestamp_ms", "t_ns", "t_us", "t_ms",
)  # fmt: skip
_TABLE = "a log in CSV has one header line, and a number in each cell below it"
_SCALES = {"_ms": 1e-3, "_us": 1e-6, "_ns": 1e-9}
_EPOCHS = ((1e17, 1e-9, "nanoseconds"), (1e14, 1e-6, "microseconds"), (1e11, 1e-3, "milliseconds"))
"""From this size on, a stamp of our days counts in that unit (1e9 s after 1970 was in 2001)."""


def read_csv(path: Path, rate_hz: float | None) -> list[Stream]:
    """Read a table with one header line; where cells are parted by ; or tabs, a decimal comma is one."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            sample = file.readline()
            delimiter = max(",;\t", key=sample.count)
            header = [
                name.strip().strip('"').lstrip("# ")
                for name in next(csv.reader([sample], delimiter=delimiter))
            ]
            rows = [row for row in csv.reader(file, delimiter=delimiter) if row]
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path} cannot be read: {error}") from None
    uneven = next((number for number, row in enumerate(rows, 2) if len(row) != len(header)), None)
    if uneven is not None:
        raise RecordingError(
            f"{path}:{uneven}: {len(rows[uneven - 2])} cells below a header of {len(header)}", hint=_TABLE
        )
    if not rows:
        there = "there is a header and no sample below it" if sample.strip() else "the file is empty"
        raise RecordingError(f"{path}: {there}")
    comma = delimiter != ","
    table = np.array([[_number(cell.replace(",", ".") if comma else cell) for cell in row] for row in rows])
    words = [name for place, name in enumerate(header) if np.isnan(table[:, place]).all()]
    arrays = {name: table[:, place] for place, name in enumerate(header) if name not in words}
    if not arrays:
        raise RecordingError(
            f"{path}: no column holds numbers below the header {', '.join(header)[:80]}", hint=_TABLE
        )
    return [_stream(path.stem, arrays, path, rate_hz)]


def read_npz(path: Path, rate_hz: float | None) -> list[Stream]:
    """Read the arrays of a NumPy archive: (n,) is a column, (n, k) a vector."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, BadZipFile):
        raise RecordingError(
            f"{path} is no whole NumPy archive of numbers", hint="write it anew with numpy.savez"
        ) from None
    return [_stream(path.stem, arrays, path, rate_hz)]


def read_h5(path: Path, rate_hz: float | None) -> list[Stream]:
    """Read the datasets of an HDF5 file; their stamps are those of their group, or of the nearest one around it."""
    import h5py

    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.ndim in (1, 2) and item.dtype.kind in "fiu":
            found[name] = item[()]

    try:
        with h5py.File(path) as file:
            file.visititems(visit)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error}") from None
    clocks = {name.rpartition("/")[0]: name for name in found if _is_time(name)}
    shared: dict[str, dict[str, Any]] = {}
    strays = []
    for name, values in found.items():
        around = name.rpartition("/")[0]
        while around and around not in clocks:
            around = around.rpartition("/")[0]
        as_long = [clock for clock in clocks.values() if len(found[clock]) == len(values)]
        if around not in clocks and len(as_long) == 1:
            strays.append(name)
            around = as_long[0].rpartition("/")[0]
        shared.setdefault(clocks.get(around, ""), {})[name] = values
    streams = []
    for stamp, own in ({stamp: own for stamp, own in shared.items() if stamp} or shared).items():
        stream = _stream(stamp.rpartition("/")[0] or path.stem, own, path, rate_hz)
        if lent := [name for name in strays if name in own]:
            told = (
                f"{', '.join(lent)} have no stamps of their own, and get those of {stamp}, which are as many"
            )
            stream = replace(stream, remarks=(*stream.remarks, told))
        streams.append(stream)
    return streams


def _is_time(name: str) -> bool:
    return name.rpartition("/")[2].lower() in _TIMES


def read_parquet(path: Path, rate_hz: float | None) -> list[Stream]:
    """Read a Parquet file, or a folder of a LeRobot dataset: ``observation.state``, ``action``, ``timestamp``."""
    try:
        from pyarrow import parquet
    except ImportError:
        raise RequestError(
            f"{path} needs the package pyarrow", hint='pip install "labrun[parquet]"'
        ) from None
    files = (
        sorted(path.glob("data/**/*.parquet" if (path / "meta" / "info.json").is_file() else "**/*.parquet"))
        if path.is_dir()
        else [path]
    )
    if not files:
        raise RecordingError(f"{path} holds no .parquet file", hint="a LeRobot dataset has meta/ and data/")
    information = _information(path)
    try:
        tables = [parquet.read_table(file).to_pydict() for file in files]
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path} cannot be read: {error}") from None
    arrays = {
        name: np.array([value for table in tables for value in table[name]], dtype=np.float64)
        for name in tables[0]
        if all(name in table for table in tables) and _is_numbers(tables[0][name])
    }
    names = {name: _names(entry.get("names")) for name, entry in information.get("features", {}).items()}
    rate = rate_hz or information.get("fps")
    return [_stream(path.stem, arrays, path, float(rate) if rate else None, names)]


def _information(path: Path) -> Mapping[str, Any]:
    folder = (
        path if path.is_dir() else next((up for up in path.parents if (up / "meta").is_dir()), path.parent)
    )
    file = folder / "meta" / "info.json"
    try:
        return dict(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else {}
    except (OSError, ValueError) as error:
        raise RecordingError(f"{file} cannot be read: {error}") from None


def _names(given: Any) -> tuple[str, ...] | None:
    """Return the names of a feature's parts; LeRobot has had lists, and tables of lists."""
    if isinstance(given, dict):
        given = next(iter(given.values()), None)
    return tuple(map(str, given)) if isinstance(given, list) else None


def _is_numbers(values: list[Any]) -> bool:
    first = values[0] if values else None
    parts = first if isinstance(first, list) else [first]
    return bool(parts) and all(isinstance(part, int | float) and not isinstance(part, bool) for part in parts)


def _stream(
    name: str,
    arrays: Mapping[str, Any],
    path: Path,
    rate_hz: float | None,
    names: Mapping[str, tuple[str, ...] | None] | None = None,
) -> Stream:
    tables = {
        key: np.asarray(value, dtype=np.float64) for key, value in arrays.items() if np.ndim(value) in (1, 2)
    }
    stamp = next(
        (
            key
            for known in _TIMES
            for key in tables
            if key.rpartition("/")[2].lower() == known and tables[key].ndim == 1
        ),
        None,
    )
    remarks: tuple[str, ...] = ()
    if stamp is not None:
        time_s, remarks = _seconds(stamp, tables[stamp])
        count = len(time_s)
    else:
        count = max((len(table) for table in tables.values()), default=0)
        if rate_hz is None:
            raise RequestError(
                f"{path} has no column of time; it has {', '.join(list(arrays)[:12])}",
                hint="call one of them time_s, or say the rate of its samples: --rate 100",
            )
        time_s, remarks = np.arange(count) / rate_hz, (f"no stamps: samples are taken as {rate_hz:g} Hz",)
    episode = None
    for key in [
        key for key in tables if key.rpartition("/")[2].lower() in ("episode_index", "episode", "trial")
    ]:
        episode = tables.pop(key).astype(np.int64)
    columns: list[Column] = []
    for key, table in tables.items():
        if key == stamp or len(table) != count or key in ("frame_index", "index", "task_index"):
            continue
        group, _, own = key.rpartition("/")
        columns += (
            [column(group, own, table)] if table.ndim == 1 else vector(key, table, (names or {}).get(key))
        )
    return Stream(name, time_s, tuple(columns), False, episode, remarks)


def _seconds(name: str, stamps: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    scale = next((scale for end, scale in _SCALES.items() if name.lower().endswith(end)), None)
    if scale is not None:
        return stamps * scale, ()
    largest = float(np.nanmax(np.abs(stamps), initial=0.0))
    for bound, factor, word in _EPOCHS:
        if largest > bound:
            return (stamps - stamps[0]) * factor, (f"stamps {name} count {word}, by their size",)
    return stamps, ()


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


_FILES = {
    ".csv": read_csv, ".txt": read_csv, ".npz": read_npz, ".h5": read_h5, ".hdf5": read_h5, ".parquet": read_parquet,
}  # fmt: skip
_BAGS = (".bag", ".mcap", ".db3")


def read_log(path: Path, rate_hz: float | None = None) -> list[Stream]:
    """Return what a log holds, as it is.

    Parameters
    ----------
    path
        ``.mcap``, ``.bag``, ``.db3``, a rosbag2 folder, a LeRobot dataset folder, ``.parquet``, ``.csv``, ``.npz`` or
        ``.h5``.
    rate_hz
        Of a table without stamps.

    Raises
    ------
    RequestError
        There is no such log, its kind is not known, or the package that reads it is missing.
    RecordingError
        It cannot be read.
    """
    if not path.exists():
        beside = [one.name for one in path.parent.iterdir()] if path.parent.is_dir() else []
        near = nearest(path.name, beside)
        hint = f'did you mean "{path.with_name(near)}"?' if near else f"looked from {Path.cwd()}"
        raise RequestError(f"there is no log {path}", hint=hint)
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return _held(path, read_bag(path))
        return _held(path, read_parquet(path, rate_hz))
    suffix = path.suffix.lower()
    if suffix in _BAGS:
        return _held(path, read_bag(path))
    if suffix not in _FILES:
        known = ", ".join((*_BAGS, *_FILES))
        raise RequestError(
            f"{path} is no log that labrun reads", hint=f"{known}, a rosbag2 or LeRobot folder"
        )
    return _held(path, _FILES[suffix](path, rate_hz))


def _held(path: Path, streams: list[Stream]) -> list[Stream]:
    kept = [stream for stream in streams if stream.columns and len(stream.time_s) > 1]
    if not kept:
        raise RecordingError(f"{path} holds no numbers over time")
    return kept
