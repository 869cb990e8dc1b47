"""Logs of robots made elsewhere: read, matched with a model, cleaned, cut into trials, written as a recording.

Readers return streams; each step after them returns its result with statements and questions (`labrun.logs.findings`).
"""

from labrun.logs.arrays import ReadOptions
from labrun.logs.cleaning import LEAST_SAMPLES, LogTable, Piece, joined, table_of, unusable
from labrun.logs.clocks import StampSource, align_clocks
from labrun.logs.files import read_log
from labrun.logs.findings import Finding, Question, Statement, questions, require_answered, statements
from labrun.logs.matching import NOT, Match, Wanted, matched, numbered, unused
from labrun.logs.preview import HEADER, ChannelPreview, previews
from labrun.logs.recorded import doubts_of_columns, doubts_of_ranges, doubts_of_trial
from labrun.logs.stamps import SCALES
from labrun.logs.streams import Column, Stream, column, plain
from labrun.logs.trials import LEAST_TRIAL_S, cut, in_no_trial, motions
from labrun.logs.turns import correct_turns, find_jumps
from labrun.logs.units import TICKS, AskedUnits, Unit, check_ranges, decide_units
from labrun.logs.writing import require_free, write_recording

__all__ = [
    "HEADER", "LEAST_SAMPLES", "LEAST_TRIAL_S", "NOT", "SCALES", "TICKS", "AskedUnits", "ChannelPreview", "Column",
    "Finding", "LogTable", "Match", "Piece", "Question", "ReadOptions", "StampSource", "Statement", "Stream",
    "Unit", "Wanted", "align_clocks", "check_ranges",
    "column", "correct_turns", "cut", "decide_units", "doubts_of_columns", "doubts_of_ranges",
    "doubts_of_trial", "find_jumps", "in_no_trial",
    "joined", "matched", "motions", "numbered", "plain", "previews", "questions", "read_log", "require_answered",
    "require_free", "statements", "table_of", "unusable", "unused", "write_recording",
]  # fmt: skip
