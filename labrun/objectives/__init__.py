"""Objectives: from the recorded signals of a trial to one number."""

from labrun.objectives.asked import ASKED, Asked
from labrun.objectives.protocol import Objective, Remarking, TrialSignals, Truncated, make_objective
from labrun.signals import Signal

__all__ = [
    "ASKED",
    "Asked",
    "Objective",
    "Remarking",
    "Signal",
    "TrialSignals",
    "Truncated",
    "make_objective",
]
