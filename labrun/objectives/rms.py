"""Root of the mean square."""

import numpy as np

from labrun.objectives.channel import ChannelObjective
from labrun.objectives.protocol import Signal


class Rms(ChannelObjective):
    """Root of the mean square of a channel over the recording, mean included, integrated over time."""

    def _number(self, signal: Signal) -> float:
        span = signal.time_s[-1] - signal.time_s[0]
        return float(np.sqrt(np.trapezoid(signal.values**2, signal.time_s) / span))
