"""Transfer functions of one input and one output, with a dead time: fitted to responses and simulated exactly."""

from labrun.fit.transfer.response import StateSpace
from labrun.fit.transfer.summary import TransferSummary
from labrun.fit.transfer.transfer_function import NamedTransferTable, TransferFunction

__all__ = ["NamedTransferTable", "StateSpace", "TransferFunction", "TransferSummary"]
