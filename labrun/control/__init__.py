"""Closed loops: references, feedbacks, controllers, and their execution in a trial."""

from labrun.control.closed_loop import ClosedLoopRecorder
from labrun.control.pid import FeedforwardPid, PidController
from labrun.control.plant import TransferTable, response_table
from labrun.control.protocol import LoopContext, Step
from labrun.control.references import HalfSineReference, HalfSineSettings

__all__ = [
    "ClosedLoopRecorder", "FeedforwardPid", "HalfSineReference", "HalfSineSettings",
    "LoopContext", "PidController", "Step", "TransferTable", "response_table",
]  # fmt: skip
