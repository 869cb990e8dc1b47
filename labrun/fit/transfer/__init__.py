"""Transfer functions of one input and one output, with a dead time: fitted to responses and simulated exactly."""

from labrun.fit.transfer.method import TransferSummary
from labrun.fit.transfer.transfer_function import NamedTransferTable, StateSpace, TransferFunction

__all__ = ["NamedTransferTable", "StateSpace", "TransferFunction", "TransferSummary"]
