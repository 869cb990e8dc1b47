"""Logs of robots made elsewhere: read, matched with a model, cleaned, cut into trials, written as a recording."""

from labrun.logs.cleaning import LEAST_SAMPLES, LEAST_TRIAL_S, LogTable, Piece, cut, table_of, unusable
from labrun.logs.files import read_log
from labrun.logs.matching import TICKS, Match, Unit, Wanted, in_si, matched
from labrun.logs.streams import Column, Stream, column, plain
from labrun.logs.writing import write_recording

__all__ = [
    "LEAST_SAMPLES", "LEAST_TRIAL_S", "TICKS", "Column", "LogTable", "Match", "Piece", "Stream", "Unit",
    "Wanted", "column", "cut", "in_si", "matched", "plain", "read_log", "table_of", "unusable",
    "write_recording",
]  # fmt: skip
