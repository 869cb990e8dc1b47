"""A table of trials as the folder of a recording."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.logs.cleaning import LogTable, Piece

_ALIKE = 0.01
"""Goals that differ by less than this share of their range are the same motion, told again (root mean square)."""


def write_recording(
    folder: Path,
    name: str,
    table: LogTable,
    trials: Sequence[Piece],
    remarks: Sequence[str],
    files: Mapping[str, str],
) -> None:
    """Write ``recording.toml``, a CSV file a trial, and further files beside them.

    Raises
    ------
    RequestError
        The folder is there and holds something, or cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RequestError(f"{folder} is there already, and is not overwritten", hint="--to another folder")
    columns = [
        place
        for place, one in enumerate(table.matches)
        if one.stream is not None or one.wanted.kind == "input"
    ]
    names = [table.matches[place].wanted.channel for place in columns]
    lines = [f"# {remark}" for remark in remarks]
    lines += [f"experiment = {json.dumps(name)}"]
    for place in columns:
        wanted = table.matches[place].wanted
        lines += [f"[channels.{wanted.channel}]", f'kind = "{wanted.kind}"', f'unit = "{wanted.unit}"']
        if wanted.goal:
            lines += ['between = "hold"']
    motions, trials = _motions(table, trials)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number, (piece, motion) in enumerate(zip(trials, motions, strict=True), 1):
            file = f"{number:03d}.csv"
            time_s = table.time_s[piece.first : piece.end]
            data = np.column_stack([time_s - time_s[0], table.values[piece.first : piece.end, columns]])
            header = ",".join(["time_s", *names])
            np.savetxt(folder / file, data, fmt="%.9g", delimiter=",", header=header, comments="")
            lines += ["[[trials]]", f'file = "{file}"', f'condition = {{ motion = "{motion}" }}']
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        (folder / "recording.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise RequestError(f"{folder} cannot be written: {error.strerror}") from error


def _motions(table: LogTable, trials: Sequence[Piece]) -> tuple[list[str], list[Piece]]:
    """Name each trial's motion; trials that are told the same are repeats of one, and end with the shortest of them."""
    inputs = table.recorded("input")
    span = np.maximum(np.ptp(table.values[:, inputs], axis=0), 1e-12)
    goals = [table.values[piece.first : piece.end, inputs] / span for piece in trials]
    known: list[int] = []
    motion: list[int] = []
    for goal in goals:
        found = next((k for k, first in enumerate(known) if inputs and _same(goals[first], goal)), None)
        if found is None:
            found = len(known)
            known.append(len(motion))
        motion.append(found)
    shortest = {
        k: min(len(goal) for goal, one in zip(goals, motion, strict=True) if one == k) for k in set(motion)
    }
    ends = [Piece(piece.first, piece.first + shortest[k]) for piece, k in zip(trials, motion, strict=True)]
    return [f"m{k + 1}" for k in motion], ends


def _same(one: FloatArray, other: FloatArray) -> bool:
    """Tell whether goals are the same, but for how long the last one stands."""
    count = min(len(one), len(other))
    longer = one if len(one) > count else other
    if np.ptp(longer[count - 1 :], axis=0).max(initial=0.0) > _ALIKE:
        return False
    return float(np.sqrt(np.mean((one[:count] - other[:count]) ** 2))) < _ALIKE
