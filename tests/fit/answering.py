"""The answer of a transfer function to an input that rested at 0 before, put together as the fits do it."""

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.transfer import TransferFunction
from labrun.fit.transfer.transfer_function import Hold, powers


def answer(
    transfer: TransferFunction, time_s: FloatArray, values: FloatArray, hold: Hold = "linear"
) -> FloatArray:
    above = np.array(transfer.numerator[::-1])
    step_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    return powers(transfer.denominator, transfer.dead_s, step_s, values, hold)[:, : len(above)] @ above
