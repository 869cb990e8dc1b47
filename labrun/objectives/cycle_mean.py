"""Mean over whole gait cycles."""

from collections.abc import Iterable

from labrun.errors import ExperimentError
from labrun.objectives.channel import ChannelObjective, time_mean
from labrun.objectives.protocol import TrialSignals
from labrun.signals import Signal


class CycleMean(ChannelObjective):
    """Mean of a channel over whole gait cycles after the discarded ones.

    Cut to whole cycles, so that what a symmetric gait does to and fro cancels (the source's own sanity check on side
    force); integrated over time, so that lost samples do not weight the rest of the cycle.
    """

    def __call__(self, signals: TrialSignals) -> float:
        """Return the mean, in the unit of `unit`.

        Raises
        ------
        ExperimentError
            The gait has no cycle, or the recording holds no whole one.
        """
        if signals.period_s is None:
            raise ExperimentError(
                f"{self.channel}: cycle-mean needs a gait with a cycle",
                hint='give the gait a frequency_hz, or use plugin = "mean"',
            )
        return super().__call__(signals)

    def _number(self, pieces: Iterable[Signal]) -> float:
        return time_mean(pieces)
