"""Sealed effects in dry runs, and sealed cases that score a diagnosis."""

from labrun.blind.answer import Answer, Cause, CauseName
from labrun.blind.diagnosis_check import Checked, Scored, check
from labrun.blind.hiding import HiddenBench, hidden_bench, named_model
from labrun.blind.judging import Judged
from labrun.blind.rehearsal import concealed
from labrun.blind.robot_check import CheckedRobots, JudgedJoint, check_robots
from labrun.blind.scoring import Scores, Share
from labrun.blind.seal import (
    SEALED,
    Compared,
    Hidden,
    Revealed,
    Seal,
    is_sealed,
    read_seal,
    redacted,
    reveal,
    write_seal,
)
from labrun.blind.truth import STRENGTHS

__all__ = [
    "SEALED", "STRENGTHS", "Answer", "Cause", "CauseName", "Checked", "CheckedRobots", "Compared", "Hidden",
    "HiddenBench", "Judged", "JudgedJoint", "Revealed", "Scored", "Scores", "Seal", "Share", "check", "check_robots",
    "concealed", "hidden_bench", "is_sealed", "named_model", "read_seal", "redacted", "reveal", "write_seal",
]  # fmt: skip
