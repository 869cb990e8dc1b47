"""The checks of an import, for trials that are a recording already: doubts are told, and nothing is changed."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RecordingError
from labrun.logs.cleaning import LEAST_SAMPLES, LogTable, unusable
from labrun.logs.findings import questions
from labrun.logs.matching import Match, Wanted
from labrun.logs.publishers import find_writers
from labrun.logs.stamps import is_time, stamps_of
from labrun.logs.streams import Stream, column, is_episode
from labrun.logs.text import read_text
from labrun.logs.turns import find_jumps, sort_jumps, turns_from_goal
from labrun.logs.units import check_ranges

_TURNS = {"rad": 2 * np.pi, "deg": 360.0}
_COMMAND = "_command"


def doubts_of_trial(
    file: str,
    time_s: FloatArray,
    inputs: Mapping[str, tuple[str, FloatArray]],
    outputs: Mapping[str, tuple[str, FloatArray]],
) -> Iterator[tuple[str, str]]:
    """Yield what is doubtful in a trial, and in which lines of its file.

    Parameters
    ----------
    file
        Its name, with the header in line 1.
    time_s : (n,)
    inputs, outputs : name -> (unit, values)
    """
    if len(time_s) < LEAST_SAMPLES:
        return
    channels = {**inputs, **outputs}
    for name, (unit, values) in channels.items():
        if unit not in _TURNS:
            continue
        lasting, alone = sort_jumps(find_jumps(values, (_TURNS[unit],)))
        turn = f"{_TURNS[unit]:.4g} {unit}"
        for jump in lasting[:1]:
            text = f"{name} jumps by {turn} between two samples: did its counter wrap?"
            yield (
                text,
                f"{len(lasting)} time{'s' * (len(lasting) != 1)}, first at line {jump.row + 2} of {file}",
            )
        for first, _ in alone[:1]:
            text = f"{name} lies {turn} off for a sample or two: a glitch of its counter?"
            yield text, f"{len(alone)} time{'s' * (len(alone) != 1)}, first at line {first + 2} of {file}"
        goal = channels.get(f"{name}{_COMMAND}")
        if name in outputs and goal is not None and goal[0] == unit:
            turns = turns_from_goal(values, goal[1], _TURNS[unit])
            if turns:
                yield (
                    f"{name} is measured {turns:+d} whole turns from {name}{_COMMAND}: did it lose a turn?",
                    file,
                )
    for name, (_, values) in outputs.items():
        if find_writers(values, None) is not None:
            yield f"{name} goes away and back from sample to sample, as if two sources wrote it", file
    for piece, why in unusable(_table(time_s, inputs, outputs)):
        yield why, f"lines {piece.first + 2} to {piece.end + 1} of {file}"


def doubts_of_columns(file: Path, known: Collection[str]) -> Iterator[str]:
    """Yield what the columns of a trial's file say that are no channels of the recording.

    `known`: the names of its channels, and ``time_s``.
    """
    try:
        arrays = read_text(file).values
    except RecordingError:
        return  # what further columns hold is free
    further = [name for name in arrays if name not in known]
    for name in further:
        count = len(np.unique(arrays[name]))
        if is_episode(name) and count > 1:
            yield f"{file.name}: {name} tells {count} episodes in one trial: each is a trial, with a file of its own"
    clocks = {name: arrays[name] for name in ("time_s", *further) if name in arrays and is_time(name)}
    if len(clocks) > 1:
        stamps = stamps_of(file.name, clocks, units={"time_s": "s"}, time_unit=None, chosen=None)
        yield from (question.text for question in questions(stamps.findings))
    roles = ("torque", "torque-command", "current", "command")
    if unused := [name for name in further if column("", name, arrays[name]).role in roles]:
        yield f"{file.name}: {', '.join(unused[:12])}: not used, as recording.toml has no such channel"


def doubts_of_ranges(
    outputs: Mapping[str, tuple[str, FloatArray]], ranges: Mapping[str, tuple[float, float] | None]
) -> list[str]:
    """Return the joints that were measured outside of their range in the model."""
    matches = [
        Match(
            Wanted(name, unit, "output", (name,), ("position",), range=ranges[name]),
            Stream("", np.arange(len(values), dtype=np.float64), ()), column("", name, values), unit=unit,
        )
        for name, (unit, values) in outputs.items()
        if ranges.get(name) is not None
    ]  # fmt: skip
    return [finding.text for finding in check_ranges([matches])]


def _table(
    time_s: FloatArray,
    inputs: Mapping[str, tuple[str, FloatArray]],
    outputs: Mapping[str, tuple[str, FloatArray]],
) -> LogTable:
    wanted: Sequence[Wanted] = [
        *(Wanted(name, unit, "input", (name,), ("command",)) for name, (unit, _) in inputs.items()),
        *(Wanted(name, unit, "output", (name,), ("position",)) for name, (unit, _) in outputs.items()),
    ]
    values = np.column_stack([values for _, values in (*inputs.values(), *outputs.values())])
    count = len(time_s)
    return LogTable(
        time_s, values, tuple(wanted), (True,) * len(wanted), np.zeros(count, dtype=bool), None,
        np.zeros(count, dtype=np.int64),
    )  # fmt: skip
