"""From streams with stamps as they came to one table that can be trusted, and the trials in it.

The rule for stamps: those that repeat or run backwards are dropped, up to 5 % of them, beyond which the log is refused;
stamps of receipt that scatter by more than a third of a period, without a gap, are replaced by even ones; where more
than five periods are missing the log is cut. Everything that is done is said.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import RecordingError
from labrun.logs.matching import Match, values_of
from labrun.logs.streams import Stream

MOST_DROPPED = 0.05
GAP_PERIODS = 5.0
JITTER = 1 / 3
REST_S = 0.5
LEAST_TRIAL_S = 0.5
LEAST_SAMPLES = 20
LONG_S = 30.0
CUT_S = 10.0
OFFSET_S = 0.005
STUCK_S = 0.3
PUSH_AFTER_S = 2.0
_LIVELY = 0.5
"""A sensor of which more than this share of samples differs from the one before cannot stand still by chance."""
_COARSE = 0.5
"""Fewer different numbers than this share of the samples, and a sensor's steps are coarser than its noise."""
_OFTEN = 0.02
"""So is one that repeats a number more often than this where it is not frozen: friction holds joints still."""
_NOISE_STEPS, _NOISE_WANDERS = 12.0, 0.5
"""A joint never moved whose span is at most so many median steps (noise: about 8) and whose means over a rest's length
span at most that part of it (0.2)."""
_JUMP = 2.0
"""A coarse sensor was frozen if it goes on with a step so many times its fastest ones."""


@dataclass(frozen=True)
class LogTable:
    """Inputs and outputs on one time, in the model's units.

    Attributes
    ----------
    time_s : (n,)
        From the first sample.
    values : (n, channels)
        In the order of `matches`.
    matches
    broken : (n,)
        Whether a gap, or another episode, lies before a sample.
    """

    time_s: FloatArray
    values: FloatArray
    matches: tuple[Match, ...]
    broken: NDArray[np.bool_]

    def recorded(self, kind: Literal["input", "output"]) -> list[int]:
        """Return the columns of the inputs, or of the outputs, that the log has."""
        return [
            place
            for place, one in enumerate(self.matches)
            if one.wanted.kind == kind and one.stream is not None
        ]


@dataclass(frozen=True)
class Piece:
    """A part of the table, from sample `first` to before `end`."""

    first: int
    end: int


def repaired(
    stream: Stream, used: Sequence[int]
) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.bool_], list[str]]:
    """Return the good stamps of a stream, which samples they are of, where it is broken, and what was done.

    `used`: its columns that must hold a number. Raises RecordingError: more stamps repeat or run backwards than the
    rule allows.
    """
    said: list[str] = []
    finite = np.isfinite(stream.time_s)
    for place in used:
        finite &= np.isfinite(stream.columns[place].values)
    index = np.flatnonzero(finite)
    if len(index) < len(stream.time_s):
        said.append(f"{stream.name}: {len(stream.time_s) - len(index)} samples without a number are left out")
    if len(index) < 2:
        raise RecordingError(f"{stream.name} has no two whole samples")
    time_s = stream.time_s[index]
    episode = stream.episode[index] if stream.episode is not None else np.zeros(len(index), dtype=np.int64)
    edge = np.append(True, episode[1:] != episode[:-1])
    highest, kept = -np.inf, np.zeros(len(index), dtype=bool)
    for number, stamp in enumerate(time_s):
        if edge[number]:
            highest = -np.inf
        kept[number] = stamp > highest
        highest = max(highest, float(stamp))
    dropped = int((~kept).sum())
    if dropped > MOST_DROPPED * len(index):
        raise RecordingError(
            f"{stream.name}: {dropped} of {len(index)} stamps repeat or run backwards, more than {MOST_DROPPED:.0%}",
            hint="its clock or its order is broken: nothing was imported",
        )
    if dropped:
        said.append(f"{stream.name}: {dropped} samples whose stamps repeat or run backwards are left out")
    time_s, index, edge = time_s[kept], index[kept], edge[kept]
    steps = np.diff(time_s)
    inside = steps[~edge[1:] & (steps > 0)]
    period = float(np.median(inside)) if len(inside) else 1.0
    gaps = np.append(False, (steps > GAP_PERIODS * period) & ~edge[1:])
    if gaps.any():
        count = int(gaps.sum())
        said.append(
            f"{stream.name}: {count} gap{'s' * (count != 1)} of more than {GAP_PERIODS:g} periods, the longest "
            f"{float(steps[gaps[1:]].max()):.3g} s; it is cut there"
        )
    scatter = float(np.std(inside)) / period if len(inside) else 0.0
    if stream.received and scatter > JITTER and not gaps.any() and not edge[1:].any():
        even = np.linspace(time_s[0], time_s[-1], len(time_s))
        said.append(
            f"{stream.name}: stamps of receipt scatter by {scatter:.0%} of the period, and are replaced by even ones, "
            f"at most {1e3 * float(np.abs(even - time_s).max()):.3g} ms from them"
        )
        time_s = even
    return time_s, index, gaps | edge, said


def table_of(matches: Sequence[Match]) -> tuple[LogTable, list[str]]:
    """Return one table on the stamps of what is measured: goals by what stood, other measurements by straight lines.

    Raises
    ------
    RecordingError
        A stream cannot be repaired, or the streams do not overlap.
    """
    streams = [*{id(one.stream): one.stream for one in matches if one.stream is not None}.values()]
    if not streams:
        none = (
            "nothing of the model is in the log"
            if matches
            else "the model has no hinge or slide to compare a log with"
        )
        raise RecordingError(none, hint="look at --map" if matches else None)
    measured = [
        sum(one.stream is stream and one.wanted.kind == "output" for one in matches) for stream in streams
    ]
    base = streams[int(np.argmax(measured))]
    said: list[str] = [remark for stream in streams for remark in stream.remarks]
    good: dict[int, tuple[FloatArray, NDArray[np.int64], NDArray[np.bool_]]] = {}
    for stream in streams:
        used = [
            place
            for place, column in enumerate(stream.columns)
            if any(one.column is column for one in matches)
        ]
        stamps, index, broken, told = repaired(stream, used)
        good[id(stream)] = stamps, index, broken
        said += told
    time_s, _, broken = good[id(base)]
    first = max(float(good[id(one)][0][0]) for one in streams)
    last = min(float(good[id(one)][0][-1]) for one in streams if _measures(one, matches) or one is base)
    inside = (time_s >= first) & (time_s <= last)
    if inside.sum() < LEAST_SAMPLES:
        if len(time_s) < LEAST_SAMPLES:
            raise RecordingError(
                f"{base.name} has {len(time_s)} samples with a stamp of their own; at least {LEAST_SAMPLES} are needed"
            )
        raise RecordingError(
            "the topics do not overlap in time: "
            + "; ".join(
                f"{one.name} {good[id(one)][0][0]:.3f} to {good[id(one)][0][-1]:.3f} s" for one in streams
            ),
            hint="are their stamps of one clock?",
        )
    if outside := len(time_s) - int(inside.sum()):
        samples = "1 sample" if outside == 1 else f"{outside} samples"
        said.append(f"{samples} before or after the other topics left out")
    at = time_s[inside]
    values = np.zeros((len(at), len(matches)))
    for place, match in enumerate(matches):
        if match.stream is None:
            continue
        stamps, index, _ = good[id(match.stream)]
        course = values_of(match)[index]
        if match.stream is base:
            values[:, place] = course[inside]
        elif match.wanted.goal:
            values[:, place] = _standing(at, stamps, course)
        elif match.wanted.kind == "input":
            values[:, place] = course[np.maximum(np.searchsorted(stamps, at, side="right") - 1, 0)]
        else:
            values[:, place] = np.interp(at, stamps, course)
    others = [stream.name for stream in streams if stream is not base]
    if others:
        said.append(
            f"stamps of {base.name} count; goals stand until the next one, with their mean from stamp to stamp, other "
            f"measurements run straight between theirs: {', '.join(others)}"
        )
    return LogTable(at - at[0], values, tuple(matches), broken[inside]), [*said, *_offset(streams)]


def _standing(at: FloatArray, stamps: FloatArray, course: FloatArray) -> FloatArray:
    """Return the mean, from each time to the next, of a goal that stands until its next one.

    What stood at each time would come late by half a period in the mean: as much as a clock that is off.
    """
    period = float(np.median(np.diff(at)))
    ends = np.append(at[1:], at[-1] + period)
    first = np.maximum(np.searchsorted(stamps, at, side="right") - 1, 0)
    last = np.maximum(np.searchsorted(stamps, ends, side="left") - 1, first)
    values = course[first]
    for place in np.flatnonzero(last > first):
        goals = slice(first[place], last[place] + 1)
        edges = np.concatenate([[at[place]], stamps[first[place] + 1 : goals.stop], [ends[place]]])
        # of differences, so that a goal that is told again is exactly what it was
        changes = course[goals] - course[first[place]]
        values[place] += float(changes @ np.diff(edges)) / (edges[-1] - edges[0])
    return values


def _offset(streams: Sequence[Stream]) -> list[str]:
    """Return a sentence if the stamps of one stream lie further before their receipt than those of another."""
    told = sorted((one.before_receipt_s, one.name) for one in streams if one.before_receipt_s is not None)
    if not told or told[-1][0] - told[0][0] <= OFFSET_S:
        return []
    (least, early), (most, late) = told[0], told[-1]
    return [
        f"stamps of {late} lie {1e3 * most:.1f} ms before their receipt, those of {early} {1e3 * least:.1f} ms: the "
        f"{1e3 * (most - least):.1f} ms between are the way to the recorder or a clock that is off, which the log "
        "cannot tell; stamps are taken as they are"
    ]


def _measures(stream: Stream, matches: Sequence[Match]) -> bool:
    return any(one.stream is stream and one.wanted.kind == "output" for one in matches)


def unusable(table: LogTable) -> Iterator[tuple[Piece, str]]:
    """Yield what cannot be trusted: a sensor that stands still or at its end, and motion that nobody commanded."""
    period = float(np.median(np.diff(table.time_s)))
    long = max(LEAST_SAMPLES, round(STUCK_S / period))
    inputs, outputs = table.recorded("input"), table.recorded("output")
    for place in outputs:
        course = table.values[:, place]
        same = np.append(False, np.diff(course) == 0.0)
        if same.mean() > 1 - _LIVELY:
            continue  # an encoder's steps: standing still is nothing special
        steps = np.abs(np.diff(course))
        # where an encoder's steps show through, a joint at rest stands on one number: only a jump afterwards tells
        runs = _runs(same)
        short = sum(one.end - one.first for one in runs if one.end - one.first < long)
        coarse = len(np.unique(course)) < _COARSE * len(course) or short > _OFTEN * len(course)
        jump = _JUMP * float(np.quantile(steps, 0.99)) if coarse else 0.0
        for piece in runs:
            ended = piece.end >= len(course) or bool(table.broken[piece.end])
            if jump and (ended or steps[piece.end - 1] <= jump):
                continue
            if piece.end - piece.first >= long:
                ends = (course.min(), course.max())
                what = "stands at the end of its range" if course[piece.first] in ends else "is frozen"
                yield Piece(piece.first - 1, piece.end), f"{table.matches[place].wanted.channel} {what}"
    if not inputs or not outputs:
        return
    still = np.append(False, (np.diff(table.values[:, inputs], axis=0) == 0.0).all(axis=1)) & ~table.broken
    after = round(PUSH_AFTER_S / period)
    for piece in _runs(still):
        begun = piece.first + after
        if piece.end - begun < long:
            continue
        for place in outputs:
            course = table.values[begun : piece.end, place]
            noise = 1.4826 * float(np.median(np.abs(course - np.median(course))))
            span = float(np.ptp(table.values[:, place]))
            moved = np.abs(course - np.median(course)) > max(0.05 * span, 8 * noise)
            if moved.any():
                where = np.flatnonzero(moved)
                yield (
                    Piece(begun + int(where[0]), begun + int(where[-1]) + 1),
                    f"{table.matches[place].wanted.channel} moves while nothing is commanded, as if pushed by hand",
                )


def _runs(flags: NDArray[np.bool_]) -> list[Piece]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [Piece(int(first), int(end)) for first, end in zip(edges[::2], edges[1::2], strict=True)]


def cut(table: LogTable, every_s: float | None, bad: Sequence[Piece]) -> tuple[list[Piece], str]:
    """Return the trials, and how they were cut: at rests, or every so many seconds."""
    usable = np.ones(len(table.time_s), dtype=bool)
    for piece in bad:
        usable[piece.first : piece.end] = False
    starts = table.broken.copy()
    starts[0] = True
    pieces: list[Piece] = []
    for run in _runs(usable):
        inner = [
            run.first,
            *(run.first + 1 + np.flatnonzero(starts[run.first + 1 : run.end])).tolist(),
            run.end,
        ]
        pieces += [Piece(first, end) for first, end in pairwise(inner)]
    if every_s is not None:
        return _kept(
            table, [part for piece in pieces for part in _evenly(table, piece, every_s)]
        ), f"every {every_s:g} s"
    rests = _rests(table)
    at_rest = _kept(table, [part for piece in pieces for part in _between_rests(table, piece, rests)])
    if len(at_rest) > len(_kept(table, pieces)):
        return at_rest, f"at rests of {REST_S:g} s and more"
    if max(table.time_s[piece.end - 1] - table.time_s[piece.first] for piece in pieces) > LONG_S:
        parts = [part for piece in pieces for part in _evenly(table, piece, CUT_S)]
        return _kept(table, parts), f"every {CUT_S:g} s, as it has no rests"
    return _kept(table, pieces), "not at all" if len(pieces) == 1 else "where it is broken"


def _rests(table: LogTable) -> list[Piece]:
    """Return where nothing is told and nothing moves."""
    period = float(np.median(np.diff(table.time_s)))
    width = max(2, round(REST_S / period))
    quiet = np.ones(len(table.time_s), dtype=bool)
    for place, match in enumerate(table.matches):
        if match.stream is None:
            continue
        course, span = table.values[:, place], float(np.ptp(table.values[:, place]))
        if span == 0.0:
            continue
        noise = float(np.median(np.abs(np.diff(course)))) if match.wanted.kind == "output" else 0.0
        windows = np.lib.stride_tricks.sliding_window_view(course, min(width, len(course)))
        if span <= _NOISE_STEPS * noise and np.ptp(windows.mean(axis=1)) <= _NOISE_WANDERS * span:
            continue  # a joint that never moves shows its noise only: it rests all the time
        calm = np.ptp(windows, axis=1) <= max(0.01 * span, min(6 * noise, 0.03 * span))
        covered = np.zeros(len(course), dtype=bool)
        for first in np.flatnonzero(calm):
            covered[first : first + width] = True
        quiet &= covered
    return [piece for piece in _runs(quiet) if piece.end - piece.first >= width]


def _between_rests(table: LogTable, piece: Piece, rests: Sequence[Piece]) -> list[Piece]:
    """Cut in each rest inside, a fixed time before the next goal, so that repeats of a motion begin alike."""
    lead = max(1, round(REST_S / 2 / float(np.median(np.diff(table.time_s)))))
    inputs = table.recorded("input")
    told = np.flatnonzero((np.diff(table.values[:, inputs], axis=0) != 0.0).any(axis=1))
    edges = [piece.first]
    for rest in rests:
        middle = (rest.first + rest.end) // 2
        after = told[told >= middle]
        if inputs and not len(after):
            break
        edge = max(rest.first, int(after[0]) - lead) if inputs else middle
        if piece.first < edge < piece.end:
            edges = [edge] if rest.first <= piece.first else [*edges, edge]
    edges.append(piece.end)
    return [Piece(first, end) for first, end in pairwise(edges)]


def _evenly(table: LogTable, piece: Piece, every_s: float) -> list[Piece]:
    time_s = table.time_s[piece.first : piece.end]
    marks = np.arange(time_s[0] + every_s, time_s[-1] + 1e-9, every_s)
    edges = [piece.first, *(piece.first + np.searchsorted(time_s, marks)).tolist(), piece.end]
    return [Piece(first, end) for first, end in pairwise(edges) if end > first]


def _kept(table: LogTable, pieces: Sequence[Piece]) -> list[Piece]:
    return [
        piece
        for piece in pieces
        if piece.end - piece.first >= LEAST_SAMPLES
        and table.time_s[piece.end - 1] - table.time_s[piece.first] >= LEAST_TRIAL_S
    ]
