"""How far a channel has gone: from the beginning of the recording to its end, and how fast, over whole cycles."""

from typing import ClassVar

import numpy as np
from pydantic import NonNegativeFloat

from labrun.errors import ExperimentError
from labrun.objectives.channel import ChannelObjective, ChannelSettings
from labrun.objectives.protocol import TrialSignals


class Change(ChannelObjective):
    """The channel at the end of the recording less the channel at its beginning: a distance, from a position.

    Discarded cycles count here: what a swimmer does not cover while it gets going is part of how far it comes.
    """

    offset_free: ClassVar[bool] = True

    def __call__(self, signals: TrialSignals) -> float:
        """Return the change, in the unit of `unit`."""
        ends = _at(signals, self.channel, (signals.start_s, signals.end_s))
        return self._factor * (ends[1] - ends[0])


class RateOfChangeSettings(ChannelSettings):
    """Keys of `rate-of-change`: what lies before `from_s` does not count."""

    from_s: NonNegativeFloat = 0.0


class RateOfChange(ChannelObjective):
    """Change of a channel per second: a mean speed, from a position.

    Over the last whole cycles of the gait after `from_s` and after the discarded ones, so that to and fro within a
    cycle cancels; without a cycle over all that lies behind `from_s`.
    """

    Settings: ClassVar[type[ChannelSettings]] = RateOfChangeSettings
    offset_free: ClassVar[bool] = True
    _settings: RateOfChangeSettings

    def unit(self, channel_unit: str) -> str:
        """Return the channel's unit per second."""
        return f"{super().unit(channel_unit)}/s"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the rate, in the unit of `unit`. Raises ExperimentError: no whole cycle is left."""
        start_s, end_s, period_s = signals.start_s, signals.end_s, signals.period_s
        if period_s is not None:
            start_s += signals.discard_cycles * period_s
        start_s = max(start_s, self._settings.from_s)
        if period_s is not None:
            start_s = end_s - int((end_s - start_s) / period_s + 1e-6) * period_s
        if not start_s < end_s:
            raise ExperimentError(
                f"the recording of {signals.end_s - signals.start_s:.4g} s holds no whole cycle after "
                f"{self._settings.from_s:g} s and {signals.discard_cycles} discarded cycles",
                hint="make it longer, or count from an earlier time",
            )
        ends = _at(signals, self.channel, (start_s, end_s))
        return self._factor * (ends[1] - ends[0]) / (end_s - start_s)


def _at(signals: TrialSignals, channel: str, times_s: tuple[float, float]) -> tuple[float, float]:
    """Return a channel at two times, between the samples beside each."""
    values: dict[float, float] = {}
    for piece in signals.pieces(channel):
        known = piece.known()
        for at_s in times_s if len(known.time_s) else ():
            if at_s >= known.time_s[0] or at_s not in values:
                values[at_s] = float(np.interp(at_s, known.time_s, known.values))
    if not values:
        raise ExperimentError(f"{channel} holds no number")
    return values[times_s[0]], values[times_s[1]]
