"""Whole turns that a joint did not make: counters that wrap, glitches of one turn, servos that lost a turn.

A joint moves far less than a turn between two samples; where its log jumps by a turn there, the number wrapped. A jump
that lasts is taken back; a sample that lies a turn off alone is left out.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.logs.findings import Finding, Statement
from labrun.logs.matching import Match

_MOST_STEP = 0.25
"""Usual steps are below this part of a turn: a joint whose samples lie further apart may have turned."""
_NEAR = 0.02
"""A jump is a whole turn within this part of one, or within a few usual steps."""
_STEPS = 4.0
_ALONE = 2
"""A jump that is taken back within so many samples is a glitch."""
_GAP_PERIODS = 5.0
_OFF = 0.1
"""Goals and measurements that differ by a whole turn do so within this part of one."""
_COUNTERS = (4096.0, 65536.0)
"""Where counters of ticks wrap beside their own turn."""


@dataclass(frozen=True)
class Jump:
    """A jump by whole turns before sample `row`: by `turns` turns of the length `turn`."""

    row: int
    turns: int
    turn: float


def find_jumps(
    values: FloatArray, turns: Sequence[float], edges: NDArray[np.bool_] | None = None
) -> list[Jump]:
    """Return where a signal jumps by whole turns from one sample to the next.

    Parameters
    ----------
    values : (n,)
        Finite.
    turns
        Lengths of a turn, in the unit of the values; the first that fits a jump is taken.
    edges : (n,)
        Samples that begin an episode: before them nothing is a jump.
    """
    steps = np.diff(values)
    if len(steps) < 3 or not len(turns):
        return []
    usual = float(np.quantile(np.abs(steps), 0.9))
    large = np.abs(steps) > 0.5 * min(turns)
    if large.mean() > 0.25:
        return []
    usual = float(np.quantile(np.abs(steps[~large]), 0.98)) if (~large).any() else usual
    jumps = []
    for row in np.flatnonzero(large):
        if edges is not None and edges[row + 1]:
            continue
        for turn in sorted(turns, reverse=True):
            count = round(float(steps[row]) / turn)
            off = abs(float(steps[row]) - count * turn)
            tolerance = min(max(_STEPS * usual, _NEAR * turn), _MOST_STEP * turn)
            if count and usual <= _MOST_STEP * turn and off <= tolerance:
                jumps.append(Jump(int(row) + 1, count, turn))
                break
    return jumps


def without_jumps(values: FloatArray, turn: float) -> FloatArray:
    """Return a finite signal without its jumps by whole turns of one length."""
    jumps = find_jumps(values, (turn,))
    if not jumps:
        return values
    taken = np.zeros(len(values))
    for jump in jumps:
        taken[jump.row :] += jump.turns * turn
    return values - taken


def correct_turns(matches: Sequence[Match]) -> tuple[list[Match], list[Finding]]:
    """Return the matches of one log without turns that no joint made, and what was done."""
    findings: list[Finding] = []
    made = [_corrected(match, findings) for match in matches]
    measured = {match.wanted.names[0]: match for match in made if match.wanted.kind == "output"}
    for index, (before, match) in enumerate(zip(matches, made, strict=True)):
        other = measured.get(match.wanted.names[0])
        if match.wanted.kind != "input" or match.turn is None or other is None or other.column is None:
            continue
        if match is not before and _apart(before, other) < _apart(match, other):
            # the joint followed a goal of a whole turn
            made[index] = before
            findings[:] = [finding for finding in findings if finding.channel != match.wanted.channel]
            match = before  # noqa: PLW2901
        shifted = _beside_goal(match, other, findings)
        if shifted is not other:
            made[made.index(other)] = measured[match.wanted.names[0]] = shifted
    return made, findings


def _corrected(match: Match, findings: list[Finding]) -> Match:
    column, stream = match.column, match.stream
    if column is None or stream is None or match.turn is None:
        return match
    rows = np.flatnonzero(np.isfinite(column.values) & np.isfinite(stream.time_s))
    values, time_s = column.values[rows].copy(), stream.time_s[rows]
    edges = None
    if stream.episode is not None and len(rows):
        edges = np.append(True, np.diff(stream.episode[rows]) != 0)
    lengths = (match.turn, *_COUNTERS) if match.unit == "ticks" else (match.turn,)
    jumps = find_jumps(values, tuple(dict.fromkeys(lengths)), edges)
    if not jumps:
        return match
    lasting, alone = sort_jumps(jumps)
    name, period_s = match.wanted.channel, float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    for jump in lasting:
        end = len(values)
        if edges is not None and (later := np.flatnonzero(edges[jump.row :])).size:
            end = jump.row + int(later[0])
        values[jump.row : end] -= jump.turns * jump.turn
    if lasting:
        after_gap = [
            jump for jump in lasting if time_s[jump.row] - time_s[jump.row - 1] > _GAP_PERIODS * period_s
        ]
        at = ", ".join(f"{time_s[jump.row]:.3f}" for jump in lasting[:5]) + (
            ", ..." if len(lasting) > 5 else ""
        )
        lost = f"; {len(after_gap)} after a gap, as of a servo that was switched off" if after_gap else ""
        how = f"by {_lengths(lasting)} between two samples {_times(len(lasting))}, at {at} s"
        findings.append(Statement(f"{name} jumps {how}: unwrapped{lost}", name))
    for first, end in alone:
        values[first:end] = np.nan
    if alone:
        count = sum(end - first for first, end in alone)
        samples = "1 single sample lies" if count == 1 else f"{count} single samples lie"
        text = f"{name}: {samples} whole turns off, the first at {time_s[alone[0][0]]:.3f} s; left out"
        findings.append(Statement(text, name))
    whole = column.values.copy()
    whole[rows] = values
    return replace(match, column=replace(column, values=whole))


def sort_jumps(jumps: Sequence[Jump]) -> tuple[list[Jump], list[tuple[int, int]]]:
    """Return the jumps that last, and where a jump is taken back at once (first sample, end)."""
    lasting: list[Jump] = []
    alone: list[tuple[int, int]] = []
    index = 0
    while index < len(jumps):
        jump = jumps[index]
        back = jumps[index + 1] if index + 1 < len(jumps) else None
        if (
            back is not None
            and back.row - jump.row <= _ALONE
            and back.turns * back.turn == -jump.turns * jump.turn
        ):
            alone.append((jump.row, back.row))
            index += 2
            continue
        lasting.append(jump)
        index += 1
    return lasting, alone


def turns_from_goal(values: FloatArray, goals: FloatArray, turn: float) -> int:
    """Return by how many whole turns a joint is measured away from its goals, 0 where it is no whole number."""
    off = (values - goals) / turn
    middle = float(np.nanmedian(off))
    turns = round(middle)
    return turns if abs(middle - turns) < _OFF and np.nanmean(np.abs(off - turns) < _MOST_STEP) > 0.9 else 0


def _beside_goal(goal: Match, measured: Match, findings: list[Finding]) -> Match:
    """Return what was measured, moved by the whole turns between it and its goal, in every part without a gap."""
    column, stream = measured.column, measured.stream
    if (
        goal.stream is None
        or goal.column is None
        or column is None
        or stream is None
        or measured.turn is None
    ):
        return measured
    values, name = column.values.copy(), measured.wanted.channel
    moved: list[str] = []
    for rows, goal_rows in _segments(measured, goal):
        finite = goal_rows[np.isfinite(goal.column.values[goal_rows])]
        if len(finite) < 2 or not np.isfinite(values[rows]).any():
            continue
        expected = np.interp(stream.time_s[rows], goal.stream.time_s[finite], goal.column.values[finite])
        expected = (expected * goal.to_si[0] + goal.to_si[1] - measured.to_si[1]) / measured.to_si[0]
        turns = turns_from_goal(values[rows], expected, measured.turn)
        if turns:
            values[rows] -= turns * measured.turn
            moved.append(f"{turns:+d}")
    if not moved:
        return measured
    parts = f" in {len(moved)} part{'s' * (len(moved) != 1)} of the log"
    text = (
        f"{name} is measured {', '.join(dict.fromkeys(moved))} whole turns from its goal"
        f"{parts}, as of a servo that lost its turn when it was switched on: taken back"
    )
    findings.append(Statement(text, name))
    return replace(measured, column=replace(column, values=values))


def _segments(measured: Match, goal: Match) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield the rows of what is measured between gaps and episodes, and those of its goals in that episode."""
    if measured.stream is None or goal.stream is None:
        return
    time_s, own, other = measured.stream.time_s, measured.stream.episode, goal.stream.episode
    steps = np.diff(time_s)
    begins = steps > _GAP_PERIODS * float(np.median(steps)) if len(steps) else np.empty(0, dtype=bool)
    if own is not None:
        begins |= np.diff(own) != 0
    edges = [0, *(np.flatnonzero(begins) + 1).tolist(), len(time_s)]
    for first, end in pairwise(edges):
        rows = np.arange(first, end)
        if own is None or other is None:
            yield rows, np.arange(len(goal.stream.time_s))
        else:
            yield rows, np.flatnonzero(other == own[first])


def _apart(goal: Match, measured: Match) -> float:
    """Return the median distance of a goal from what is measured, rad."""
    if goal.stream is None or measured.stream is None:
        return math.inf
    at, goals = goal.stream.time_s, goal.in_si()
    rows = np.isfinite(goals) & np.isfinite(at)
    values = measured.in_si()
    whole = np.isfinite(values) & np.isfinite(measured.stream.time_s)
    if rows.sum() < 2 or not whole.any():
        return math.inf
    order = np.argsort(at[rows], kind="stable")
    expected = np.interp(measured.stream.time_s[whole], at[rows][order], goals[rows][order])
    return float(np.mean(np.abs(values[whole] - expected)))


def _lengths(jumps: Sequence[Jump]) -> str:
    return " and ".join(
        f"{length:.6g}" for length in dict.fromkeys(abs(jump.turns) * jump.turn for jump in jumps)
    )


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
