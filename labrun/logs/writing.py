"""A table of trials as the folder of a recording."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from labrun.errors import RequestError
from labrun.logs.cleaning import LogTable, Piece


def require_free(folder: Path) -> None:
    """Raise RequestError if a folder cannot become a recording."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RequestError(f"{folder} already exists, and is not overwritten", hint="--to another folder")


def write_recording(
    folder: Path,
    name: str,
    table: LogTable,
    trials: Sequence[Piece],
    motions: Sequence[str],
    logs: Sequence[str],
    remarks: Sequence[str],
    files: Mapping[str, str],
) -> None:
    """Write ``recording.toml``, a CSV file a trial, and further files beside them.

    Parameters
    ----------
    motions
        The name of each trial's motion.
    logs
        Names of the logs; with more than one, which log a trial is of is part of its condition.

    Raises
    ------
    RequestError
        The folder is there and holds something, or cannot be written.
    """
    require_free(folder)
    columns = [
        index
        for index, (wanted, has) in enumerate(zip(table.wanted, table.has, strict=True))
        if has or wanted.kind == "input"
    ]
    names = [table.wanted[column].channel for column in columns]
    lines = [f"# {remark}" for remark in remarks]
    lines += [f"experiment = {json.dumps(name)}"]
    for column in columns:
        wanted = table.wanted[column]
        lines += [f"[channels.{wanted.channel}]", f'kind = "{wanted.kind}"', f'unit = "{wanted.unit}"']
        if wanted.goal:
            lines += ['between = "hold"']
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number, (piece, motion) in enumerate(zip(trials, motions, strict=True), 1):
            file = f"{number:03d}.csv"
            time_s = table.time_s[piece.first : piece.end]
            data = np.column_stack([time_s - time_s[0], table.values[piece.first : piece.end, columns]])
            header = ",".join(["time_s", *names])
            np.savetxt(folder / file, data, fmt="%.9g", delimiter=",", header=header, comments="")
            log = f", log = {json.dumps(logs[table.log[piece.first]])}" if len(logs) > 1 else ""
            lines += ["[[trials]]", f'file = "{file}"', f'condition = {{ motion = "{motion}"{log} }}']
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        (folder / "recording.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise RequestError(f"{folder} cannot be written: {error.strerror}") from error
