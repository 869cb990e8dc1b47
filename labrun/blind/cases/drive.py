"""What the inputs are between their samples, at any time and also some time ago."""

from collections.abc import Sequence

import numpy as np

from .plant import Between, FloatArray


class Drive:
    """Inputs of all trials.

    Parameters
    ----------
    time_s : (samples,)
        Even, from zero.
    inputs : (inputs, samples, trials)
    between
        Of each input.
    """

    def __init__(self, time_s: FloatArray, inputs: FloatArray, between: Sequence[Between]) -> None:
        self.step_s = float(time_s[1] - time_s[0])
        self.count, self.samples, self.trials = inputs.shape
        self.inputs = inputs
        self._linear = np.array([one == "linear" for one in between], dtype=bool)

    def at(self, t: float, inside: float) -> FloatArray:
        """Return the inputs (inputs, trials) at a time, as seen from `inside`, which tells the side of a jump."""
        u = np.empty((self.count, self.trials))
        for row in range(self.count):
            u[row] = self.one(row, t, inside)
        return u

    def one(self, row: int, t: float, inside: float) -> FloatArray:
        """Return one input (trials,); before zero it is its first sample, after the last its last."""
        # a sample's time divided by the step may fall a rounding error short of its number
        k = int(np.floor(inside / self.step_s + 1e-9))
        signal: FloatArray = self.inputs[row]
        if k < 0:
            return np.asarray(signal[0])
        if k >= self.samples - 1:
            return np.asarray(signal[-1])
        if not self._linear[row]:
            return np.asarray(signal[k])
        share = t / self.step_s - k
        return np.asarray((1.0 - share) * signal[k] + share * signal[k + 1])

    def fine(self, row: int, parts: int) -> tuple[float, FloatArray]:
        """Return one input on a grid so many times as fine: its step, and its samples (fine samples, trials)."""
        step_s = self.step_s / parts
        count = (self.samples - 1) * parts + 1
        # a point of the fine grid on a sample is seen from after it
        signal = np.array([self.one(row, index * step_s, (index + 1e-3) * step_s) for index in range(count)])
        return step_s, signal
