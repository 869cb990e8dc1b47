"""Parquet files and LeRobot data sets, whose ``meta/info.json`` names joints, rate and robot."""

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import RecordingError, RequestError
from labrun.logs.arrays import Arrays, ReadOptions, streams_of
from labrun.logs.containers import require_affordable
from labrun.logs.findings import Finding, Statement
from labrun.logs.streams import Stream

_PERCENT_GRIPPERS = re.compile(r"(?i)so[-_]?10[01]|koch|lekiwi|omx")
"""Robots of LeRobot whose gripper is written as 0 to 100 of its range, whatever the other joints are in."""
_BATCH = 65_536
"""So many rows are decoded at once."""


def read_parquet(path: Path, options: ReadOptions) -> list[Stream]:
    """Read a Parquet file, or a folder of a LeRobot data set: ``observation.state``, ``action``, ``timestamp``."""
    try:
        from pyarrow import parquet
    except ImportError:
        raise RequestError(
            f"{path} needs the package pyarrow", hint='pip install "labrun[parquet]"'
        ) from None
    information = _information(path)
    files = (
        sorted(path.glob("data/**/*.parquet" if information else "**/*.parquet")) if path.is_dir() else [path]
    )
    if not files:
        raise RecordingError(f"{path} holds no .parquet file", hint="a LeRobot data set has meta/ and data/")
    tables = []
    for file in files:
        try:
            tables.append(_table(file, parquet))
        except (OSError, ValueError, NotImplementedError) as error:
            raise RecordingError(f"{file} cannot be read: {error}") from None
    shared = [name for name in tables[0] if all(name in table for table in tables)]
    findings: list[Finding] = []
    if lost := sorted({name for table in tables for name in table} - set(shared)):
        findings.append(
            Statement(f"{path.name}: {', '.join(lost[:8])} are not in all {len(files)} files; left out")
        )
    lengths = [len(next(iter(table.values()), ())) for table in tables]
    values: dict[str, Any] = {
        name: np.concatenate([table.pop(name) for table in tables]) if len(tables) > 1 else tables[0][name]
        for name in shared
    }
    if len(files) > 1 and "episode_index" not in values:
        values["episode_index"] = np.repeat(np.arange(len(files)), lengths)
    labels = {name: _names(entry.get("names")) for name, entry in information.get("features", {}).items()}
    findings += _counted(path, values, information)
    rate = options.rate_hz or information.get("fps")
    arrays = Arrays(values, labels, _gripper_units(information, labels), tuple(findings))
    streams = streams_of(path.stem, arrays, replace(options, rate_hz=float(rate) if rate else None))
    return [replace(stream, lerobot=bool(information)) for stream in streams]


def _table(file: Path, parquet: Any) -> dict[str, Any]:
    """Return the columns of numbers, times and vectors of one width."""
    import pyarrow as pa

    whole = parquet.ParquetFile(file)
    names = [field.name for field in whole.schema_arrow if _width(field.type, pa) is not None]
    groups = [whole.metadata.row_group(index) for index in range(whole.metadata.num_row_groups)]
    chunks = [group.column(index) for group in groups for index in range(group.num_columns)]
    require_affordable(
        file, sum(chunk.num_values for chunk in chunks if chunk.path_in_schema.partition(".")[0] in names)
    )
    table = {}
    for name in names:  # in pieces: Arrow takes several times as much memory for lists as their numbers need
        pieces = [
            _numbers(batch.column(0), pa)
            for batch in whole.iter_batches(_BATCH, columns=[name], use_threads=False)
        ]
        arrays = [piece for piece in pieces if piece is not None]
        if len(arrays) == len(pieces) > 0 and len({array.shape[1:] for array in arrays}) == 1:
            table[name] = _since_first(np.concatenate(arrays), whole.schema_arrow.field(name).type, pa)
    return table


def _width(kind: Any, pa: Any) -> int | None:
    """Return 1 for numbers and times, 2 for lists of numbers, None for what is neither."""
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        return 2 if _width(kind.value_type, pa) == 1 else None
    number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_timestamp(kind)
    return 1 if number else None


def _numbers(column: Any, pa: Any) -> NDArray[Any] | None:
    if _width(column.type, pa) == 2:
        flat = _numbers(column.flatten(), pa)
        width, remainder = divmod(0 if flat is None else len(flat), max(len(column), 1))
        return (
            None if flat is None or remainder or not width or column.null_count else flat.reshape(-1, width)
        )
    if pa.types.is_timestamp(column.type):
        counts: NDArray[Any] = column.cast(pa.int64()).to_numpy(zero_copy_only=False)
        return counts
    numbers: FloatArray = column.cast(pa.float64()).to_numpy(zero_copy_only=False)
    return numbers


def _since_first(values: Any, kind: Any, pa: Any) -> FloatArray:
    """Return numbers as doubles, and times as seconds since the first: their counts have more digits than a double."""
    if not pa.types.is_timestamp(kind):
        return np.asarray(values, dtype=np.float64)
    per_s = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[kind.unit]
    first = values[np.isfinite(values)][:1].sum()
    return np.asarray(values - first, dtype=np.float64) / per_s


def _information(path: Path) -> Mapping[str, Any]:
    folder = (
        path if path.is_dir() else next((up for up in path.parents if (up / "meta").is_dir()), path.parent)
    )
    file = folder / "meta" / "info.json"
    try:
        given = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    except (OSError, ValueError) as error:
        raise RecordingError(f"{file} cannot be read: {error}") from None
    if not isinstance(given, dict) or not isinstance(given.get("features", {}), dict):
        raise RecordingError(
            f"{file} is not the description of a LeRobot data set: a table of features was expected"
        )
    return given


def _names(given: Any) -> tuple[str, ...] | None:
    """Return the names of a feature's parts; LeRobot has had lists, and tables of lists."""
    if isinstance(given, dict):
        given = next(iter(given.values()), None)
    return tuple(map(str, given)) if isinstance(given, list) else None


def _gripper_units(
    information: Mapping[str, Any], labels: Mapping[str, tuple[str, ...] | None]
) -> dict[str, str]:
    """Return the unit that the data set's kind of robot states: its gripper is 0 to 100."""
    if not _PERCENT_GRIPPERS.search(str(information.get("robot_type", ""))):
        return {}
    return {name: "percent" for names in labels.values() for name in names or () if "gripper" in name.lower()}


def _counted(path: Path, values: Mapping[str, Any], information: Mapping[str, Any]) -> list[Finding]:
    """Return what is said if the data set holds another number of episodes or samples than its description."""
    findings: list[Finding] = []
    rows = len(next(iter(values.values()), ()))
    episodes = len(np.unique(values["episode_index"])) if "episode_index" in values else 0
    for key, count in (("total_frames", rows), ("total_episodes", episodes)):
        stated = information.get(key)
        if isinstance(stated, int) and stated != count and count:
            findings.append(
                Statement(f"{path.name}: meta/info.json states {key} {stated}, and {count} were found")
            )
    return findings
