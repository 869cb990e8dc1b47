"""Named arrays, as CSV, NumPy, HDF5, MATLAB, tensors and Parquet hold them, made into streams.

Which array is the time of which, and which groups or labels are episodes.
"""

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import RecordingError, RequestError
from labrun.logs.findings import Finding, Statement, statements
from labrun.logs.stamps import is_time, is_time_by_unit, stamps_of
from labrun.logs.streams import Column, Stream, column, episode_runs, is_episode, vector

_EPISODE_GROUP = re.compile(
    r"(?i)(demo|episode|ep|trial|traj|trajectory|rollout|run|take|seq|sequence)s?[_-]?(\d+)"
)
_CLOCK_WORDS = {
    "", "t", "time", "times", "timestamp", "timestamps", "stamp", "s", "ms", "us", "ns", "sec", "secs", "seconds",
    "nanosec", "nsec", "nsecs", "nanosecs", "nanoseconds", "header", "datetime", "date", "clock", "utc", "tout",
}  # fmt: skip
_LEAST_RUN = 20
"""Time starts anew if it stays for so many samples below where it was: one wrong stamp does not last."""
_COUNTERS = ("frame_index", "index", "task_index")


@dataclass(frozen=True)
class ReadOptions:
    """What a person said of a log's time.

    Attributes
    ----------
    rate_hz
        Of samples without stamps.
    time_unit
        Of columns of time: ``s``, ``ms``, ``us`` or ``ns``.
    times : array -> its column of time
        "" stands for all arrays.
    """

    rate_hz: float | None = None
    time_unit: str | None = None
    times: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Arrays:
    """What a file holds: arrays of shape (n,) or (n, k) by path, and what it says of them.

    Attributes
    ----------
    values
    labels
        Names of the columns of an array.
    units
        Of an array, or of a column by its label.
    findings
    """

    values: Mapping[str, Any]
    labels: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()


def streams_of(name: str, arrays: Arrays, options: ReadOptions) -> list[Stream]:
    """Return the streams of a file called `name`.

    Raises
    ------
    RequestError
        Nothing holds time, and no rate was stated; or a column named with ``--time`` is missing.
    RecordingError
        The file holds no array of numbers.
    """
    values = {path: table for path, given in arrays.values.items() if (table := _table(given)) is not None}
    if not values:
        raise RecordingError(f"{name} holds no arrays of numbers")
    episodes = _episode_groups(values)
    if not episodes:
        return _with_findings(_streams(name, values, arrays, options), arrays.findings)
    common = {path: table for path, table in values.items() if _episode_of(path) is None}
    parts = [_streams(name, own, arrays, options) for own in episodes.values()]
    streams = _joined(parts, list(episodes))
    findings: list[Finding] = [
        *arrays.findings,
        Statement(f"{name}: {len(episodes)} groups are {len(episodes)} episodes, each a trial"),
    ]
    if common:
        findings.append(Statement(f"{name}: {', '.join(list(common)[:6])} outside of the episodes; left out"))
    return _with_findings(streams, findings)


def _table(given: Any) -> FloatArray | None:
    if not isinstance(given, np.ndarray) or given.dtype.kind not in "fiub" or given.ndim not in (1, 2):
        return None
    return np.asarray(given, dtype=np.float64) if len(given) else None


def _episode_of(path: str) -> tuple[str, int] | None:
    """Return the path without the group of its episode, and the episode's number."""
    parts = path.split("/")
    for index, part in enumerate(parts[:-1]):
        match = _EPISODE_GROUP.fullmatch(part)
        if match:
            return "/".join([*parts[:index], *parts[index + 1 :]]), int(match[2])
    return None


def _episode_groups(values: Mapping[str, FloatArray]) -> dict[int, dict[str, FloatArray]]:
    groups: dict[int, dict[str, FloatArray]] = {}
    for path, table in values.items():
        episode = _episode_of(path)
        if episode is not None:
            groups.setdefault(episode[1], {})[episode[0]] = table
    return dict(sorted(groups.items()))


def _joined(parts: Sequence[Sequence[Stream]], episodes: Sequence[int]) -> list[Stream]:
    """Return streams of the same columns in all episodes as one, with the episode of each sample."""
    groups: dict[tuple[str, ...], list[tuple[int, Stream]]] = {}
    for episode, streams in zip(episodes, parts, strict=True):
        for stream in streams:
            groups.setdefault(tuple(column_.name for column_ in stream.columns), []).append((episode, stream))
    joined = []
    for members in groups.values():
        first = members[0][1]
        columns = tuple(
            replace(column_, values=np.concatenate([stream.columns[index].values for _, stream in members]))
            for index, column_ in enumerate(first.columns)
        )
        findings = tuple(dict.fromkeys(finding for _, stream in members for finding in stream.findings))
        if len(members) < len(episodes):
            text = f"{first.columns[0].name} and its group are in {len(members)} of {len(episodes)} episodes"
            findings = (*findings, Statement(text))
        labels = np.concatenate([np.full(len(stream.time_s), episode) for episode, stream in members])
        time_s = np.concatenate([stream.time_s for _, stream in members])
        joined.append(replace(first, time_s=time_s, columns=columns, episode=labels, findings=findings))
    return joined


def _streams(
    name: str, values: Mapping[str, FloatArray], arrays: Arrays, options: ReadOptions
) -> list[Stream]:
    flat = {path: table.reshape(-1) for path, table in values.items() if table.size == len(table)}
    clocks = {path: table for path, table in flat.items() if path in options.times.values() or is_time(path)}
    if not clocks:
        clocks = {
            path: table
            for path, table in flat.items()
            if is_time_by_unit(path, arrays.units.get(path, ""), table)
        }
    signals = {path: table for path, table in values.items() if path not in clocks}
    for chosen in options.times.values():
        if chosen not in clocks:
            raise RequestError(
                f"--time {chosen}: {name} has no such column", hint=f"it has {', '.join(list(values)[:12])}"
            )
    if not clocks:
        return [_without_stamps(name, signals, arrays, options)]
    shared: dict[tuple[str, ...], dict[str, FloatArray]] = {}
    lent: dict[str, str] = {}
    alone: dict[str, int] = {}
    names = set().union(*map(_words, signals))
    for path, table in signals.items():
        own, is_lent = _clocks_of(path, len(table), clocks, names, options)
        if not own:
            alone[path] = len(table)
            continue
        if is_lent:
            lent[path] = own[0]
        shared.setdefault(own, {})[path] = table
    streams = []
    several = len(shared) > 1
    for own, tables in shared.items():
        stated = options.times.get(next(iter(tables))) or options.times.get("")
        stamps = stamps_of(
            name, {path: clocks[path] for path in own}, units=arrays.units, time_unit=options.time_unit,
            chosen=stated if stated in own else None,
        )  # fmt: skip
        called = (own[0].rpartition("/")[0] or own[0]) if several else name
        findings = list(stamps.findings)
        if borrowed := [path for path in tables if path in lent]:
            text = f"{', '.join(borrowed)} have no stamps of their own, and get those of {own[0]}, which are as many"
            findings.append(Statement(text))
        streams.append(_stream(called, tables, stamps.time_s, arrays, findings))
    if alone:
        unmatched = ", ".join(f"{path} ({count})" for path, count in list(alone.items())[:8])
        counts = ", ".join(f"{path} {len(table)}" for path, table in list(clocks.items())[:4])
        text = f"{name}: no stamps of as many samples for {unmatched}; left out (stamps: {counts}; --time ARRAY=STAMPS)"
        if streams:
            streams[0] = replace(streams[0], findings=(*streams[0].findings, Statement(text)))
        else:
            raise RecordingError(text)
    return streams


def _clocks_of(
    path: str, count: int, clocks: Mapping[str, FloatArray], names: Set[str], options: ReadOptions
) -> tuple[tuple[str, ...], bool]:
    """Return the columns of time of an array, the nearest ones first, and whether they are of another group.

    `names`: the words in the paths of all arrays; a column of time that has one of them is of that array alone.
    """
    chosen = options.times.get(path) or options.times.get("")
    if chosen is not None:
        return ((chosen,), False) if len(clocks[chosen]) == count else ((), False)
    alike = [clock for clock in clocks if len(clocks[clock]) == count]
    group = path.rpartition("/")[0]
    while True:
        inside = [clock for clock in alike if clock.rpartition("/")[0] == group]
        if inside or not group:
            break
        group = group.rpartition("/")[0]
    named = [clock for clock in inside or alike if _names_of_clock(clock) & _words(path)]
    if named:
        return tuple(named), False
    shared = [clock for clock in inside if not _names_of_clock(clock) & names]
    if shared or inside:
        return tuple(shared or inside), False
    return (alike[0],) if len({clock.rpartition("/")[0] for clock in alike}) == 1 else (), True


def _words(path: str) -> set[str]:
    return set(re.split(r"[^a-z0-9]+", path.lower()))


def _names_of_clock(clock: str) -> set[str]:
    """Return what a column of time is of, by its name: ``t_cmd`` is of ``cmd``."""
    return _words(clock.rpartition("/")[2]) - _CLOCK_WORDS


def _without_stamps(
    name: str, signals: Mapping[str, FloatArray], arrays: Arrays, options: ReadOptions
) -> Stream:
    if options.rate_hz is None:
        raise RequestError(
            "; ".join(
                [
                    f"{name} has no column of time; it has {', '.join(list(signals)[:12])}",
                    *statements(arrays.findings),
                ]
            ),
            hint="call one of them time_s (numbers, or ISO 8601), name it with --time COLUMN, or state the "
            "rate of its samples: --rate 100",
        )
    count = max(len(table) for table in signals.values())
    findings: list[Finding] = [Statement(f"{name}: no stamps; samples are taken as {options.rate_hz:g} Hz")]
    if others := [f"{path} ({len(table)})" for path, table in signals.items() if len(table) != count]:
        findings.append(Statement(f"{name}: {', '.join(others[:8])} have not {count} samples; left out"))
    tables = {path: table for path, table in signals.items() if len(table) == count}
    return _stream(name, tables, np.arange(count) / options.rate_hz, arrays, findings)


def _stream(
    name: str,
    tables: Mapping[str, FloatArray],
    time_s: FloatArray,
    arrays: Arrays,
    findings: list[Finding],
) -> Stream:
    episode = None
    columns: list[Column] = []
    for path, table in tables.items():
        group, _, own = path.rpartition("/")
        if is_episode(own) and table.size == len(table):
            if episode is None:
                episode = episode_runs(np.nan_to_num(table.reshape(-1)))
                count = int(episode[-1]) + 1
                findings.append(Statement(f"{name}: {path} tells {count} episode{'s' * (count != 1)}"))
            continue
        if own in _COUNTERS:
            continue
        if table.ndim == 1:
            columns.append(column(group, own, table, unit=arrays.units.get(path, "")))
            continue
        labels = arrays.labels.get(path)
        if labels is not None and len(labels) != table.shape[1]:
            findings.append(
                Statement(f"{path} has {table.shape[1]} columns and {len(labels)} names, which are not used")
            )
        for index, part in enumerate(vector(path, table, labels)):
            unit = arrays.units.get(path, "") or (
                arrays.units.get(labels[index], "") if labels and len(labels) == table.shape[1] else ""
            )
            columns.append(replace(part, unit=unit) if unit else part)
    if episode is None and len(restarts := _restarts(time_s)):
        episode = np.searchsorted(restarts, np.arange(len(time_s)), side="right")
        at = ", ".join(str(row + 1) for row in restarts[:5]) + (", ..." if len(restarts) > 5 else "")
        times = "once" if len(restarts) == 1 else f"{len(restarts)} times"
        text = f"time starts anew {times}, at sample {at}: {len(restarts) + 1} episodes"
        findings.append(Statement(f"{name}: {text}"))
    return Stream(name, time_s, tuple(columns), episode=episode, findings=tuple(findings))


def _restarts(time_s: FloatArray) -> NDArray[np.int64]:
    """Return the samples at which time falls back into the first half of its run, and stays below where it was."""
    restarts, first = [], 0
    for row in np.flatnonzero(np.diff(np.where(np.isfinite(time_s), time_s, np.nan)) < 0.0) + 1:
        later = time_s[min(int(row) + _LEAST_RUN, len(time_s)) - 1]
        lasted = time_s[row - 1] - time_s[first]
        long_enough = row - first >= _LEAST_RUN and lasted > 0.0
        if long_enough and time_s[row] - time_s[first] < 0.5 * lasted and later < time_s[row - 1]:
            restarts.append(first := int(row))
    return np.array(restarts, dtype=np.int64)


def _with_findings(streams: list[Stream], findings: Sequence[Finding]) -> list[Stream]:
    first, *others = streams
    return [replace(first, findings=(*findings, *first.findings)), *others]
