"""Columns of time: which one counts, and in which unit; the result is in seconds."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.logs.findings import Finding, Question, Statement

SCALES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_WORDS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
_NAMES = (
    "time_s", "time", "t", "timestamp", "timestamps", "stamp", "sec", "secs", "seconds", "time_ms", "time_us",
    "time_ns", "timestamp_ns", "timestamp_us", "timestamp_ms", "t_ns", "t_us", "t_ms", "t_s", "timestamp_s", "__time",
    "%time", "tout", "datetime", "date_time", "date", "clock", "utc",
)  # fmt: skip
_NAMED = re.compile(
    r"^(?:t|time|times|timestamps?|stamps?)[_.]\w+$|^\w+[_.](?:t|time|timestamps?|stamp)(?:_(?:s|ms|us|ns))?$"
)
_SECONDS, _NANOSECONDS = ("sec", "secs", "seconds"), ("nanosec", "nsec", "nsecs", "nanosecs", "nanoseconds")
_NOT_STAMPS = ("run_time", "cycle_time", "loop_time", "time_from_start", "response_time", "compute_time")
_LEAST_HZ, _LEAST_SURE_HZ, _MOST_HZ = 0.5, 2.0, 5000.0
"""Robots are logged at rates between these; between the first two, seconds and milliseconds are both possible."""
_SAME_RATE = 1e-4


@dataclass(frozen=True)
class Stamps:
    """The time of a table.

    Attributes
    ----------
    time_s : (n,)
    columns
        Names of all columns that hold time, which are no signals.
    findings
    """

    time_s: FloatArray
    columns: tuple[str, ...]
    findings: tuple[Finding, ...]


def is_time(name: str) -> bool:
    """Tell whether a column's name says that it holds time."""
    last = re.split(r"[/.]", name)[-1].strip().lower()
    last = re.sub(r"\s*[\[(].*[\])]$", "", last)
    if last in _NOT_STAMPS:
        return False
    return last in _NAMES or last in _NANOSECONDS or _NAMED.match(last) is not None


def stamps_of(
    table: str,
    arrays: Mapping[str, FloatArray],
    *,
    units: Mapping[str, str],
    time_unit: str | None,
    chosen: str | None,
) -> Stamps | None:
    """Return the time of a table; None where no column holds time.

    Parameters
    ----------
    table
        Its name, for messages.
    arrays : name -> (n,)
        Its columns, all of one length.
    units
        What a header states of columns.
    time_unit
        What a person said with ``--time-unit``.
    chosen
        The column that a person named with ``--time``.
    """
    if chosen is not None and chosen not in arrays:
        raise RequestError(
            f"--time {chosen}: {table} has no such column", hint=f"it has {', '.join(list(arrays)[:12])}"
        )
    names = [name for name in arrays if is_time(name)]
    if chosen is None and not names:
        return None
    pair = _pair(names) if chosen is None else None
    if pair is not None:
        seconds, nanoseconds = (arrays[name] for name in pair)
        first = seconds[np.isfinite(seconds)][:1].sum()
        return Stamps((seconds - first) + 1e-9 * nanoseconds, tuple(names), ())
    name = chosen or min(names, key=_preference)
    time_s, findings = _seconds(table, name, arrays[name], units.get(name, ""), time_unit)
    others = [other for other in names if other != name]
    for other in others if chosen is None else ():
        other_s, doubts = _seconds(table, other, arrays[other], units.get(other, ""), time_unit)
        findings += (
            ()
            if any(isinstance(doubt, Question) for doubt in doubts)
            else _compared(name, time_s, other, other_s)
        )
    return Stamps(time_s, tuple({name, *names}), findings)


def iso_seconds(cells: Sequence[str], name: str) -> tuple[FloatArray, tuple[Finding, ...]]:
    """Return ISO 8601 times as seconds since 1970, and whether they have a zone; not a number where a cell has none."""
    values, zoned = np.full(len(cells), np.nan), 0
    for row, cell in enumerate(cells):
        try:
            time = datetime.fromisoformat(cell.strip())
        except ValueError:
            continue
        zoned += time.tzinfo is not None
        base = datetime(1970, 1, 1, tzinfo=time.tzinfo)
        offset = time.utcoffset()
        values[row] = (time - base).total_seconds() - (offset.total_seconds() if offset else 0.0)
    finite = int(np.isfinite(values).sum())
    if 0 < zoned < finite:
        text = f"{name}: {zoned} of {finite} times have a zone, and the others none"
        return values, (Question(text, answers="write all of them with their zone"),)
    zone = (
        "with their zone" if zoned else "without a zone: a change to summer time would show as an hour's jump"
    )
    return values, (Statement(f"stamps {name} are dates and times, {zone}"),)


def is_iso(cell: Any) -> bool:
    """Tell whether a cell is a date with a time."""
    try:
        datetime.fromisoformat(str(cell).strip())
    except ValueError:
        return False
    return ":" in str(cell)


def _preference(name: str) -> int:
    last = re.split(r"[/.]", name)[-1].lower()
    return _NAMES.index(last) if last in _NAMES else len(_NAMES)


def _pair(names: Sequence[str]) -> tuple[str, str] | None:
    """Return a column of seconds and the one of nanoseconds beside it."""
    for name in names:
        head, last = re.fullmatch(r"(.*?)([^/.]*)", name).groups()  # type: ignore[union-attr]
        for nanoseconds in names:
            other = re.fullmatch(r"(.*?)([^/.]*)", nanoseconds).groups()  # type: ignore[union-attr]
            if last.lower() in _SECONDS and other[0] == head and other[1].lower() in _NANOSECONDS:
                return name, nanoseconds
    return None


def _seconds(
    table: str, name: str, stamps: FloatArray, stated: str, time_unit: str | None
) -> tuple[FloatArray, tuple[Finding, ...]]:
    finite = stamps[np.isfinite(stamps)]
    first = float(finite[0]) if len(finite) else 0.0
    # what counts from 1970 in nanoseconds has more digits than a double: differences first
    from_first = stamps - first if abs(first) > 1e8 else stamps
    if time_unit:
        return from_first * SCALES[time_unit], ()
    ending = "ns" if name == "%time" else name.lower().rpartition("_")[2] if "_" in name else ""
    unit = stated if stated in SCALES else ending if ending in SCALES else ""
    steps = np.diff(finite)
    steps = steps[steps > 0]
    if not len(steps):
        return from_first * SCALES.get(unit, 1.0), ()
    step = float(np.median(steps))
    rates_hz = {unit_: 1.0 / (step * scale) for unit_, scale in SCALES.items()}
    if unit and rates_hz[unit] >= _LEAST_HZ:
        return from_first * SCALES[unit], ()
    likely = next((unit_ for unit_, rate_hz in rates_hz.items() if rate_hz >= _LEAST_SURE_HZ), "ns")
    if likely == "s":
        return from_first, ()
    text = f"{table}: stamps {name} step by {step:.6g}"
    if unit or rates_hz[likely] > _MOST_HZ or (likely == "ms" and rates_hz["s"] >= _LEAST_HZ):
        other = unit or "s"
        text += f": {rates_hz[other]:.3g} Hz if they are {_WORDS[other]}, {rates_hz[likely]:.4g} Hz if {_WORDS[likely]}"
        question = Question(
            text,
            f"--time-unit {likely}",
            f"--time-unit {', '.join(unit_ for unit_ in SCALES if unit_ != likely)}",
            "time",
        )
        return from_first * SCALES[likely], (question,)
    statement = (
        f"{text} and count {_WORDS[likely]} by that: {rates_hz[likely]:.4g} Hz (--time-unit if they do not)"
    )
    return from_first * SCALES[likely], (Statement(statement),)


def _compared(name: str, time_s: FloatArray, other: str, other_s: FloatArray) -> tuple[Finding, ...]:
    """Return what two clocks of one table say of one another."""
    both = np.isfinite(time_s) & np.isfinite(other_s)
    if both.sum() < 3 or np.ptp(time_s[both]) == 0.0:
        return ()
    rate = float(np.polyfit(time_s[both] - time_s[both][0], other_s[both], 1)[0])
    used = f"stamps are {name}; {other} holds time as well"
    if abs(rate - 1.0) <= _SAME_RATE:
        return (Statement(f"{used} and runs alike (--time {other} takes it)"),)
    text = f"{used} and runs at {rate:.5g} of it: which clock is the robot's?"
    return (Question(text, proposal=f"--time {name}", answers=f"--time {other}", channel="time"),)
