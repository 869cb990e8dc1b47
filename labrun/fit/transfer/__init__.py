"""Transfer functions of one input and one output, with a dead time: fitted to responses and simulated exactly."""

from labrun.fit.transfer.transfer_function import TransferFunction

__all__ = ["TransferFunction"]
