"""Greatest magnitude."""

from collections.abc import Iterable

import numpy as np

from labrun.objectives.channel import ChannelObjective
from labrun.signals import Signal


class Peak(ChannelObjective):
    """The value of a channel that is farthest from zero, with its sign."""

    def _number(self, pieces: Iterable[Signal]) -> float:
        peaks = (float(piece.values[np.argmax(np.abs(piece.values))]) for piece in pieces)
        return max(peaks, key=abs)
