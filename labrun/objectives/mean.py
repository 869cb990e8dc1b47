"""Mean over the recording."""

from collections.abc import Iterable

from labrun.objectives.channel import ChannelObjective, time_mean
from labrun.signals import Signal


class Mean(ChannelObjective):
    """Mean of a channel over the recording; over its whole cycles after the discarded ones if the gait has any."""

    def _number(self, pieces: Iterable[Signal]) -> float:
        return time_mean(pieces)
