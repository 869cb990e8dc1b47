"""Greatest magnitude."""

import numpy as np

from labrun.objectives.channel import ChannelObjective
from labrun.objectives.protocol import Signal


class Peak(ChannelObjective):
    """The value of a channel that is farthest from zero, with its sign."""

    def _number(self, signal: Signal) -> float:
        return float(signal.values[np.argmax(np.abs(signal.values))])
