"""Columns of time: which one counts, and in which unit; the result is in seconds."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, time

import numpy as np

from labrun.arrays import FloatArray
from labrun.logs.findings import Finding, Question, Statement
from labrun.logs.streams import bracketed_unit

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
_MOST_STATED_HZ = 20e3
"""Drives log at this rate at most: a stated unit that makes it a higher one is doubted."""
_SAME_RATE = 1e-4
_DAY_S = 86_400.0


@dataclass(frozen=True)
class Stamps:
    """The time of a table.

    Attributes
    ----------
    time_s : (n,)
    findings
    """

    time_s: FloatArray
    findings: tuple[Finding, ...]


def is_time(name: str) -> bool:
    """Tell whether a column's name says that it holds time."""
    last = _last(name)
    if last in _NOT_STAMPS:
        return False
    return last in _NAMES or last in _NANOSECONDS or _NAMED.match(last) is not None


def is_time_by_unit(name: str, unit: str, values: FloatArray) -> bool:
    """Tell whether a column with a name in another language holds time: in a unit of time, and never running back."""
    return (unit or bracketed_unit(name)[1]) in SCALES and bool(np.all(np.diff(values) > 0))


def _last(name: str) -> str:
    """Return the last part of a path, without the unit in brackets, in small letters."""
    return re.sub(r"\s*[\[(].*[\])]$", "", re.split(r"[/.]", name)[-1].strip().lower())


def stamps_of(
    table: str,
    arrays: Mapping[str, FloatArray],
    *,
    units: Mapping[str, str],
    time_unit: str | None,
    chosen: str | None,
) -> Stamps:
    """Return the time of a table.

    Parameters
    ----------
    table
        Its name, for messages.
    arrays : name -> (n,)
        Its columns of time, all of one length.
    units
        What a header states of columns.
    time_unit
        What a person said with ``--time-unit``.
    chosen
        The column that a person named with ``--time``.
    """
    names = list(arrays)
    pair = _pair(names) if chosen is None else None
    if pair is not None:
        seconds, nanoseconds = (arrays[name] for name in pair)
        first = seconds[np.isfinite(seconds)][:1].sum()
        return Stamps((seconds - first) + 1e-9 * nanoseconds, ())
    name = chosen or min(names, key=_preference)
    time_s, findings = _seconds(table, name, arrays[name], units.get(name, ""), time_unit)
    for other in names if chosen is None else ():
        if other == name:
            continue
        other_s, doubts = _seconds(table, other, arrays[other], units.get(other, ""), time_unit)
        if not any(isinstance(doubt, Question) for doubt in doubts):
            findings += _compared(name, time_s, other, other_s)
    return Stamps(time_s, findings)


def date_seconds(cells: Sequence[str], name: str) -> tuple[FloatArray, tuple[Finding, ...]]:
    """Return ISO 8601 dates with times as seconds since 1970, and times of day as seconds since midnight.

    A cell without a time is not a number. Times of day go on after midnight. Also returned: whether they have a zone.
    """
    values, zoned, dated = np.full(len(cells), np.nan), 0, 0
    for row, cell in enumerate(cells):
        moment = _moment(cell)
        if moment is None:
            continue
        zoned += moment.tzinfo is not None
        dated += moment.year > 1
        offset = moment.utcoffset()
        base = datetime(1970, 1, 1, tzinfo=moment.tzinfo)
        values[row] = (moment - base).total_seconds() - (offset.total_seconds() if offset else 0.0)
    finite = np.flatnonzero(np.isfinite(values))
    if 0 < zoned < len(finite):
        text = f"{name}: {zoned} of {len(finite)} times have a zone, and the others none"
        return values, (Question(text, answers="write all of them with their zone"),)
    if not dated and len(finite):
        midnights = np.append(False, np.diff(values[finite]) < -0.5 * _DAY_S)
        values[finite] += _DAY_S * np.cumsum(midnights) - _DAY_S * np.floor(values[finite[0]] / _DAY_S)
        return values, (Statement(f"stamps {name} are times of day, counted on over midnight"),)
    zone = (
        "with their zone" if zoned else "without a zone: a change to summer time would show as an hour's jump"
    )
    return values, (Statement(f"stamps {name} are dates and times, {zone}"),)


def is_date(cell: str) -> bool:
    """Tell whether a cell is a date with a time, or a time of day."""
    return _moment(cell) is not None


def _moment(cell: str) -> datetime | None:
    """Return the date and time of a cell; a time of day in the year 1; None where it has no time."""
    if ":" not in cell:
        return None
    try:
        return datetime.fromisoformat(cell.strip())
    except ValueError:
        pass
    try:
        return datetime.combine(datetime.min, time.fromisoformat(cell.strip()))
    except ValueError:
        return None


def _preference(name: str) -> int:
    last = _last(name)
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
    stated = stated or bracketed_unit(name)[1]
    unit = stated if stated in SCALES else ending if ending in SCALES else ""
    steps = np.diff(finite)
    steps = steps[steps > 0]
    if not len(steps):
        return from_first * SCALES.get(unit, 1.0), ()
    step = float(np.median(steps))
    rates_hz = {unit_: 1.0 / (step * scale) for unit_, scale in SCALES.items()}
    if unit and _LEAST_HZ <= rates_hz[unit] <= _MOST_STATED_HZ:
        return from_first * SCALES[unit], ()
    likely = next((unit_ for unit_, rate_hz in rates_hz.items() if rate_hz >= _LEAST_SURE_HZ), "ns")
    if likely == "s" and unit in ("", "s"):
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
