"""Root of the mean square."""

import math
from collections.abc import Iterable

import numpy as np

from labrun.objectives.channel import ChannelObjective, time_mean
from labrun.signals import Signal


class Rms(ChannelObjective):
    """Root of the mean square of a channel over the recording, mean included, integrated over time."""

    def _number(self, pieces: Iterable[Signal]) -> float:
        return math.sqrt(time_mean(pieces, np.square))
