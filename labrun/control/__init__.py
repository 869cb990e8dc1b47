"""Closed loops: references, feedbacks and controllers, and what runs them in a trial."""

from labrun.control.closed_loop import ClosedLoopRecorder
from labrun.control.feedforward import FeedforwardPid
from labrun.control.pid import PidController
from labrun.control.protocol import LoopContext, Step

__all__ = [
    "ClosedLoopRecorder",
    "FeedforwardPid",
    "LoopContext",
    "PidController",
    "Step",
]
