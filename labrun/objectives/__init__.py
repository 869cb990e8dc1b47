"""Objectives: from the recorded signals of a trial to one number."""

from labrun.objectives.protocol import Objective, Signal, TrialSignals, make_objective

__all__ = ["Objective", "Signal", "TrialSignals", "make_objective"]
