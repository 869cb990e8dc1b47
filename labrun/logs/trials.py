"""The trials in a log: its episodes, or cut at rests or evenly; repeats of one motion; what tells trials apart."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from labrun.arrays import FloatArray
from labrun.logs.cleaning import LEAST_SAMPLES, LogTable, Piece, runs_of
from labrun.logs.findings import Finding, Statement

REST_S = 0.5
LEAST_TRIAL_S = 0.5
LONG_S = 30.0
CUT_S = 10.0
_NOISE_STEPS, _NOISE_WANDERS = 12.0, 0.5
"""A joint never moved whose span is at most so many median steps (noise: about 8) and whose means over a rest's length
span at most that part of it (0.2)."""
_ALIKE = 0.01
"""Goals that differ by less than this share of their range are the same motion, told again (root mean square)."""


def cut(table: LogTable, every_s: float | None, bad: Sequence[Piece]) -> tuple[list[Piece], str]:
    """Return the trials, and how they were cut: its episodes whole, at rests, or every so many seconds."""
    usable = np.ones(len(table.time_s), dtype=bool)
    for piece in bad:
        usable[piece.first : piece.end] = False
    starts = table.broken.copy()
    starts[0] = True
    pieces: list[Piece] = []
    for run in runs_of(usable):
        inner = [
            run.first,
            *(run.first + 1 + np.flatnonzero(starts[run.first + 1 : run.end])).tolist(),
            run.end,
        ]
        pieces += [Piece(first, end) for first, end in pairwise(inner)]
    if every_s is not None:
        return _kept(
            table, [part for piece in pieces for part in _evenly(table, piece, every_s)]
        ), f"cut every {every_s:g} s"
    if table.episode is not None:
        count = len(np.unique(np.stack([table.log, table.episode]), axis=1).T)
        return _kept(table, pieces), f"cut into its {count} episode{'s' * (count != 1)}"
    rests = _rests(table)
    at_rest = _kept(table, [part for piece in pieces for part in _between_rests(table, piece, rests)])
    if len(at_rest) > len(_kept(table, pieces)):
        return at_rest, f"cut at rests of {REST_S:g} s and more"
    longest_s = max(
        (table.time_s[piece.end - 1] - table.time_s[piece.first] for piece in pieces), default=0.0
    )
    if longest_s > LONG_S:
        parts = [part for piece in pieces for part in _evenly(table, piece, CUT_S)]
        return _kept(table, parts), f"cut every {CUT_S:g} s, as it has no rests"
    return _kept(table, pieces), "not cut: one trial" if len(pieces) == 1 else "cut at its gaps"


def _rests(table: LogTable) -> list[Piece]:
    """Return where nothing is told and nothing moves."""
    period = table.period_s
    width = max(2, round(REST_S / period))
    quiet = np.ones(len(table.time_s), dtype=bool)
    for index, wanted in enumerate(table.wanted):
        if not table.has[index]:
            continue
        course, span = table.values[:, index], float(np.ptp(table.values[:, index]))
        if span == 0.0:
            continue
        noise = float(np.median(np.abs(np.diff(course)))) if wanted.kind == "output" else 0.0
        windows = np.lib.stride_tricks.sliding_window_view(course, min(width, len(course)))
        if span <= _NOISE_STEPS * noise and np.ptp(windows.mean(axis=1)) <= _NOISE_WANDERS * span:
            continue  # a joint that never moves shows its noise only: it rests all the time
        calm = np.ptp(windows, axis=1) <= max(0.01 * span, min(6 * noise, 0.03 * span))
        covered = np.zeros(len(course), dtype=bool)
        for first in np.flatnonzero(calm):
            covered[first : first + width] = True
        quiet &= covered
    return [piece for piece in runs_of(quiet) if piece.end - piece.first >= width]


def _between_rests(table: LogTable, piece: Piece, rests: Sequence[Piece]) -> list[Piece]:
    """Cut in each rest inside, a fixed time before the next goal, so that repeats of a motion begin alike."""
    lead = max(1, round(REST_S / 2 / table.period_s))
    inputs = table.recorded("input")
    goal_changes = np.flatnonzero((np.diff(table.values[:, inputs], axis=0) != 0.0).any(axis=1))
    edges = [piece.first]
    for rest in rests:
        middle = (rest.first + rest.end) // 2
        after = goal_changes[goal_changes >= middle]
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


def motions(table: LogTable, trials: Sequence[Piece]) -> tuple[list[str], list[Piece], list[Finding]]:
    """Name each trial's motion, and let repeats of one motion end together; return also what was cut off for that.

    Episodes stay whole. What was cut at rests ends with the shortest repeat: how long the last goal stood is no part of
    the motion.
    """
    inputs = table.recorded("input")
    span = np.maximum(np.ptp(table.values[:, inputs], axis=0), 1e-12)
    goals = [table.values[piece.first : piece.end, inputs] / span for piece in trials]
    firsts: list[int] = []
    labels: list[int] = []
    for goal in goals:
        label = next((k for k, first in enumerate(firsts) if inputs and _same(goals[first], goal)), None)
        if label is None:
            label = len(firsts)
            firsts.append(len(labels))
        labels.append(label)
    names = [f"m{label + 1}" for label in labels]
    if table.episode is not None:
        return names, list(trials), []
    shortest = {
        label: min(len(goal) for goal, own in zip(goals, labels, strict=True) if own == label)
        for label in labels
    }
    ends = [
        Piece(piece.first, piece.first + shortest[label]) for piece, label in zip(trials, labels, strict=True)
    ]
    trimmed = sum(piece.end - end.end for piece, end in zip(trials, ends, strict=True))
    findings: list[Finding] = []
    if trimmed:
        text = f"{trimmed} samples at the ends of repeats are left out, so that repeats of one motion end together"
        findings.append(Statement(text))
    return names, ends, findings


def in_no_trial(table: LogTable, trials: Sequence[Piece], bad: Sequence[Piece]) -> list[Finding]:
    """Return how much of the table is in no trial, beside what cannot be trusted."""
    used = np.zeros(len(table.time_s), dtype=bool)
    for piece in (*trials, *bad):
        used[piece.first : piece.end] = True
    unused = int((~used).sum())
    if not unused:
        return []
    text = (
        f"{unused} samples ({unused * table.period_s:.3g} s) are in no trial: rest before the first goal, or pieces "
        f"shorter than {LEAST_TRIAL_S:g} s"
    )
    return [Statement(text)]


def _same(goal: FloatArray, other: FloatArray) -> bool:
    """Tell whether goals are the same, but for how long the last one stands."""
    count = min(len(goal), len(other))
    longer = goal if len(goal) > count else other
    if np.ptp(longer[count - 1 :], axis=0).max(initial=0.0) > _ALIKE:
        return False
    return float(np.sqrt(np.mean((goal[:count] - other[:count]) ** 2))) < _ALIKE
