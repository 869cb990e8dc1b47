"""From streams with stamps as they came to one table that can be trusted.

The rule for stamps: those that repeat or run backwards are dropped, up to 5 % of them, beyond which the log is refused;
stamps of receipt that scatter by more than a third of a period, without a gap, are replaced by even ones; where more
than five periods are missing the log is cut. Everything that is done is said, with its number.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import RecordingError
from labrun.logs.findings import Finding, Statement
from labrun.logs.matching import Match, Wanted
from labrun.logs.streams import Stream

MOST_DROPPED = 0.05
GAP_PERIODS = 5.0
JITTER = 1 / 3
LEAST_SAMPLES = 20
STUCK_S = 0.3
PUSH_AFTER_S = 2.0
_LIVELY = 0.5
"""A sensor of which more than this share of samples differs from the one before cannot stand still by chance."""
_COARSE = 0.5
"""Fewer different numbers than this share of the samples, and a sensor's steps are coarser than its noise."""
_OFTEN = 0.02
"""So is one that repeats a number more often than this where it is not frozen: friction holds joints still."""
_JUMP = 2.0
"""A coarse sensor was frozen if it goes on with a step so many times its fastest ones."""


@dataclass(frozen=True)
class LogTable:
    """Inputs and outputs on one time, in the model's units.

    Attributes
    ----------
    time_s : (n,)
        From the first sample; where episodes or logs follow one another, each goes on after the one before.
    values : (n, channels)
        In the order of `wanted`.
    wanted
    has
        Whether the log has each channel.
    broken : (n,)
        Whether a gap, or another episode, lies before a sample.
    episode : (n,)
        Which episode of the log a sample belongs to; None where the log has none.
    log : (n,)
        Which of several logs, from 0.
    """

    time_s: FloatArray
    values: FloatArray
    wanted: tuple[Wanted, ...]
    has: tuple[bool, ...]
    broken: NDArray[np.bool_]
    episode: NDArray[np.int64] | None
    log: NDArray[np.int64]

    def recorded(self, kind: Literal["input", "output"]) -> list[int]:
        """Return the columns of the inputs, or of the outputs, that the log has."""
        return [
            index
            for index, (wanted, has) in enumerate(zip(self.wanted, self.has, strict=True))
            if wanted.kind == kind and has
        ]

    @property
    def period_s(self) -> float:
        """The usual time between two samples."""
        return float(np.median(np.diff(self.time_s)))


@dataclass(frozen=True)
class Piece:
    """A part of the table, from sample `first` to before `end`."""

    first: int
    end: int


@dataclass(frozen=True)
class _Repaired:
    """The good samples of a stream.

    Attributes
    ----------
    time_s, index : (m,)
        Stamps, and which samples of the stream they are of.
    broken : (m,)
        Whether a gap or another episode lies before a sample.
    gap : (m,)
        Whether a gap does.
    """

    time_s: FloatArray
    index: NDArray[np.int64]
    broken: NDArray[np.bool_]
    gap: NDArray[np.bool_]


def repaired(stream: Stream, finite: NDArray[np.bool_]) -> tuple[_Repaired, list[Finding]]:
    """Return the good samples of a stream, and what was done.

    `finite`: which samples hold a number in every column that is used. Raises RecordingError: more stamps repeat or run
    backwards than the rule allows.
    """
    findings: list[Finding] = []

    def say(text: str) -> None:
        findings.append(Statement(f"{stream.name}: {text}"))

    index = np.flatnonzero(finite & np.isfinite(stream.time_s))
    if lost := len(stream.time_s) - len(index):
        say(f"{lost} sample{'s' * (lost != 1)} without a number {'are' if lost != 1 else 'is'} left out")
    if len(index) < 2:
        raise RecordingError(f"{stream.name} has no two whole samples")
    time_s = stream.time_s[index]
    episode = stream.episode[index] if stream.episode is not None else np.zeros(len(index), dtype=np.int64)
    edge = np.append(True, episode[1:] != episode[:-1])
    kept = _increasing(time_s, edge)
    dropped = int((~kept).sum())
    if dropped > MOST_DROPPED * len(index):
        raise RecordingError(
            f"{stream.name}: {dropped} of {len(index)} stamps repeat or run backwards, more than {MOST_DROPPED:.0%}",
            hint="its clock or its order is broken: nothing was imported",
        )
    if dropped:
        say(f"{dropped} samples whose stamps repeat or run backwards are left out")
    time_s, index, episode = time_s[kept], index[kept], episode[kept]
    edge = np.append(True, episode[1:] != episode[:-1])
    steps = np.diff(time_s)
    inside = steps[~edge[1:] & (steps > 0)]
    period = float(np.median(inside)) if len(inside) else 1.0
    gap = np.append(False, (steps > GAP_PERIODS * period) & ~edge[1:])
    if gap.any():
        count, longest = int(gap.sum()), float(steps[gap[1:]].max())
        say(
            f"{count} gap{'s' * (count != 1)} of more than {GAP_PERIODS:g} periods, the longest {longest:.3g} s; "
            "it is cut there"
        )
    scatter = float(np.std(inside)) / period if len(inside) else 0.0
    if stream.received and scatter > JITTER and not gap.any() and not edge[1:].any():
        even = np.linspace(time_s[0], time_s[-1], len(time_s))
        say(
            f"stamps of receipt scatter by {scatter:.0%} of the period, and are replaced by even ones, at most "
            f"{1e3 * float(np.abs(even - time_s).max()):.3g} ms from them"
        )
        time_s = even
    return _Repaired(time_s, index, gap | edge, gap), findings


def _increasing(time_s: FloatArray, edge: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which stamps are later than all before them in their episode."""
    kept = np.ones(len(time_s), dtype=bool)
    starts = [*np.flatnonzero(edge).tolist(), len(time_s)]
    for first, end in pairwise(starts):
        highest = np.maximum.accumulate(time_s[first:end])
        kept[first + 1 : end] = time_s[first + 1 : end] > highest[:-1]
    return kept


def table_of(matches: Sequence[Match]) -> tuple[LogTable, list[Finding]]:
    """Return one table on the stamps of what is measured: goals by what stood, other measurements by cubics.

    Raises
    ------
    RecordingError
        A stream cannot be repaired, or the streams do not overlap.
    """
    streams = [*{id(match.stream): match.stream for match in matches if match.stream is not None}.values()]
    if not streams:
        none = (
            "nothing of the model is in the log"
            if matches
            else "the robot has no hinge or slide, and no actuator, that a log could tell of"
        )
        raise RecordingError(none)
    base = max(streams, key=lambda stream: (_outputs(stream, matches), len(stream.time_s)))
    findings: list[Finding] = []
    good: dict[int, _Repaired] = {}
    for stream in streams:
        finite = np.ones(len(stream.time_s), dtype=bool)
        for match in matches:
            if match.stream is stream and match.column is not None:
                finite &= np.isfinite(match.column.values)
        good[id(stream)], repairs = repaired(stream, finite)
        findings += repairs
    parts, outside, lost = [], 0, []
    own = good[id(base)]
    labels = None if base.episode is None else base.episode[own.index]
    episodes = [None] if labels is None else list(dict.fromkeys(labels.tolist()))
    for episode in episodes:
        rows = np.arange(len(own.time_s)) if labels is None else np.flatnonzero(labels == episode)
        part = _on_base(matches, base, streams, good, rows, episode)
        if len(part[0]) < min(LEAST_SAMPLES, len(rows)) and labels is not None:
            lost.append(episode)
            continue
        outside += len(rows) - len(part[0])
        parts.append(part)
    if labels is not None and lost:
        text = f"{len(lost)} of {len(episodes)} episodes have fewer than {LEAST_SAMPLES} samples; left out"
        findings.append(Statement(text))
    time_s, rows_kept, values = _concatenated(parts)
    if len(time_s) < LEAST_SAMPLES:
        if len(own.time_s) < LEAST_SAMPLES:
            raise RecordingError(
                f"{base.name} has {len(own.time_s)} samples with a stamp of their own; at least {LEAST_SAMPLES} are "
                "needed"
            )
        spans = "; ".join(
            f"{stream.name} {good[id(stream)].time_s[0]:.3f} to {good[id(stream)].time_s[-1]:.3f} s"
            for stream in streams
        )
        raise RecordingError(
            f"the topics do not overlap in time: {spans}", hint="are their stamps of one clock?"
        )
    if outside:
        samples = "1 sample" if outside == 1 else f"{outside} samples"
        findings.append(Statement(f"{samples} before or after the other topics, or in their gaps, left out"))
    broken = own.broken[rows_kept] | np.append(True, np.diff(rows_kept) != 1)
    goals = {
        match.stream.name
        for match in matches
        if match.wanted.goal and match.stream is not None and match.stream is not base
    }
    if goals:
        text = f"stamps of {base.name} count; goals stand until the next one, with their mean from stamp to stamp"
        findings.append(Statement(f"{text}: {', '.join(sorted(goals))}"))
    findings += _resampled(matches, base, good)
    table = LogTable(
        time_s, values, tuple(match.wanted for match in matches), tuple(match.stream is not None for match in matches),
        broken, None if labels is None else labels[rows_kept], np.zeros(len(time_s), dtype=np.int64),
    )  # fmt: skip
    return table, findings


def joined(tables: Sequence[LogTable]) -> LogTable:
    """Return the tables of several logs of one robot as one.

    Raises RecordingError: they do not hold the same channels.
    """
    first = tables[0]
    for number, table in enumerate(tables[1:], 2):
        if table.has != first.has:
            names = [
                wanted.channel
                for wanted, own, other in zip(first.wanted, table.has, first.has, strict=True)
                if own != other
            ]
            raise RecordingError(
                f"log {number} and log 1 do not both have {', '.join(names)}",
                hint=f"leave it out of all of them: --map {names[0]}=none",
            )
    starts = np.cumsum([0.0, *(float(table.time_s[-1]) + table.period_s for table in tables[:-1])])
    episode = None
    if any(table.episode is not None for table in tables):
        episode = np.concatenate(
            [
                np.zeros(len(table.time_s), dtype=np.int64) if table.episode is None else table.episode
                for table in tables
            ]
        )
    return LogTable(
        np.concatenate([table.time_s + start for table, start in zip(tables, starts, strict=True)]),
        np.concatenate([table.values for table in tables]), first.wanted, first.has,
        np.concatenate([table.broken for table in tables]), episode,
        np.concatenate([np.full(len(table.time_s), number) for number, table in enumerate(tables)]),
    )  # fmt: skip


def _outputs(stream: Stream, matches: Sequence[Match]) -> int:
    return sum(match.stream is stream and match.wanted.kind == "output" for match in matches)


def _concatenated(
    parts: Sequence[tuple[FloatArray, NDArray[np.int64], FloatArray]],
) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Return the parts one after another, each a period after the one before."""
    if not parts:
        return np.empty(0), np.empty(0, dtype=np.int64), np.empty((0, 0))
    period = max((float(np.median(np.diff(part[0]))) for part in parts if len(part[0]) > 1), default=1.0)
    times, begin = [], 0.0
    for time_s, _, _ in parts:
        if len(time_s):
            times.append(time_s - time_s[0] + begin)
            begin = float(times[-1][-1]) + period
    return (
        np.concatenate(times) if times else np.empty(0),
        np.concatenate([part[1] for part in parts]),
        np.concatenate([part[2] for part in parts]),
    )


def _on_base(
    matches: Sequence[Match],
    base: Stream,
    streams: Sequence[Stream],
    good: dict[int, _Repaired],
    rows: NDArray[np.int64],
    episode: int | None,
) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Return the stamps of an episode that all streams cover, their rows of the base, and all channels there."""
    own = good[id(base)]
    covering: dict[int, tuple[FloatArray, NDArray[np.int64]]] = {}
    at = own.time_s[rows]
    inside = np.ones(len(at), dtype=bool)
    for stream in streams:
        if stream is base:
            continue
        part = good[id(stream)]
        labels = None if stream.episode is None or episode is None else stream.episode[part.index]
        kept = np.ones(len(part.index), dtype=bool) if labels is None else labels == episode
        stamps, index = part.time_s[kept], part.index[kept]
        if not len(stamps):
            inside[:] = False
            continue
        covering[id(stream)] = stamps, index
        inside &= at >= stamps[0]
        if _outputs(stream, matches):
            inside &= at <= stamps[-1]
            for end in np.flatnonzero(part.gap[kept]):
                inside &= (at <= stamps[end - 1]) | (at >= stamps[end])
    at = at[inside]
    values = np.zeros((len(at), len(matches)))
    for match_index, match in enumerate(matches):
        if match.stream is None or not len(at):
            continue
        whole = match.in_si()
        if match.stream is base:
            values[:, match_index] = whole[own.index[rows[inside]]]
            continue
        stamps, index = covering[id(match.stream)]
        course = whole[index]
        if match.wanted.goal:
            values[:, match_index] = _standing(at, stamps, course)
        elif match.wanted.kind == "input":
            values[:, match_index] = course[np.maximum(np.searchsorted(stamps, at, side="right") - 1, 0)]
        else:
            values[:, match_index] = between_samples(at, stamps, course)
    return at, rows[inside], values


def between_samples(at: FloatArray, stamps: FloatArray, course: FloatArray) -> FloatArray:
    """Return a signal at other times: the cubic through the four samples around each.

    Where that would add noise, as between stamps that nearly coincide and at both ends, it is the straight line between
    two samples.

    Parameters
    ----------
    at : (m,)
    stamps, course : (n,)
        Samples, their stamps rising.
    """
    straight = np.interp(at, stamps, course)
    if len(stamps) < 4:
        return straight
    first = np.clip(np.searchsorted(stamps, at, side="right") - 2, 0, len(stamps) - 4)
    rows = first[:, np.newaxis] + np.arange(4)
    knots = stamps[rows]
    weights = np.ones_like(knots)
    for index in range(4):
        for other in set(range(4)) - {index}:
            weights[:, index] *= (at - knots[:, other]) / (knots[:, index] - knots[:, other])
    cubic = np.sum(weights * course[rows], axis=1)
    return np.where(np.sum(weights**2, axis=1) <= 1.0, cubic, straight)


def _resampled(matches: Sequence[Match], base: Stream, good: dict[int, _Repaired]) -> Iterator[Finding]:
    """Yield by how much a measurement between its own samples is off: that between every other one is off by more."""
    for match in matches:
        if match.stream is None or match.stream is base or match.wanted.kind == "input":
            continue
        own = good[id(match.stream)]
        course, parts = match.in_si()[own.index], np.cumsum(own.broken)
        missed: list[FloatArray] = []
        for part in np.unique(parts):
            rows = np.flatnonzero(parts == part)
            if len(rows) >= LEAST_SAMPLES:
                skipped = rows[1:-1:2]
                missed.append(
                    between_samples(own.time_s[skipped], own.time_s[rows[::2]], course[rows[::2]])
                    - course[skipped]
                )
        if missed:
            off = float(np.sqrt(np.mean(np.square(np.concatenate(missed)))))
            name, unit = match.wanted.channel, match.wanted.unit
            text = (
                f"{name} has stamps of its own, and is resampled to those of {base.name} by cubics; where every other "
                f"sample is left out, that misses it by {off:.2g} {unit} RMS, noise included"
            )
            yield Statement(text, name)


def _standing(at: FloatArray, stamps: FloatArray, course: FloatArray) -> FloatArray:
    """Return the mean, from each time to the next, of a goal that stands until its next one.

    What stood at each time would come late by half a period in the mean: as much as a clock that is off.
    """
    period = float(np.median(np.diff(at))) if len(at) > 1 else 0.0
    ends = np.append(at[1:], at[-1] + period)
    first = np.maximum(np.searchsorted(stamps, at, side="right") - 1, 0)
    last = np.maximum(np.searchsorted(stamps, ends, side="left") - 1, first)
    values = course[first]
    for index in np.flatnonzero(last > first):
        goals = slice(first[index], last[index] + 1)
        edges = np.concatenate([[at[index]], stamps[first[index] + 1 : goals.stop], [ends[index]]])
        # of differences, so that a goal that is told again is exactly what it was
        changes = course[goals] - course[first[index]]
        values[index] += float(changes @ np.diff(edges)) / (edges[-1] - edges[0])
    return values


def unusable(table: LogTable) -> Iterator[tuple[Piece, str]]:
    """Yield what cannot be trusted: a sensor that stands still or at its end, and motion that nobody commanded."""
    period = table.period_s
    long = max(LEAST_SAMPLES, round(STUCK_S / period))
    inputs, outputs = table.recorded("input"), table.recorded("output")
    for output in outputs:
        course = table.values[:, output]
        same = np.append(False, np.diff(course) == 0.0)
        if same.mean() > 1 - _LIVELY:
            continue  # an encoder's steps: standing still is nothing special
        steps = np.abs(np.diff(course))
        # where an encoder's steps show through, a joint at rest stands on one number: only a jump afterwards tells
        runs = runs_of(same)
        short = sum(piece.end - piece.first for piece in runs if piece.end - piece.first < long)
        coarse = len(np.unique(course)) < _COARSE * len(course) or short > _OFTEN * len(course)
        jump = _JUMP * float(np.quantile(steps, 0.99)) if coarse else 0.0
        for piece in runs:
            ended = piece.end >= len(course) or bool(table.broken[piece.end])
            if jump and (ended or steps[piece.end - 1] <= jump):
                continue
            if piece.end - piece.first >= long:
                ends = (course.min(), course.max())
                what = "stands at the end of its range" if course[piece.first] in ends else "is frozen"
                yield Piece(piece.first - 1, piece.end), f"{table.wanted[output].channel} {what}"
    if not inputs or not outputs:
        return
    still = np.append(False, (np.diff(table.values[:, inputs], axis=0) == 0.0).all(axis=1)) & ~table.broken
    after = round(PUSH_AFTER_S / period)
    for piece in runs_of(still):
        start = piece.first + after
        if piece.end - start < long:
            continue
        for output in outputs:
            course = table.values[start : piece.end, output]
            noise = 1.4826 * float(np.median(np.abs(course - np.median(course))))
            span = float(np.ptp(table.values[:, output]))
            moved = np.abs(course - np.median(course)) > max(0.05 * span, 8 * noise)
            if moved.any():
                where = np.flatnonzero(moved)
                yield (
                    Piece(start + int(where[0]), start + int(where[-1]) + 1),
                    f"{table.wanted[output].channel} moves while nothing is commanded, as if pushed by hand",
                )


def runs_of(flags: NDArray[np.bool_]) -> list[Piece]:
    """Return where flags are set, run by run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [Piece(int(first), int(end)) for first, end in zip(edges[::2], edges[1::2], strict=True)]
