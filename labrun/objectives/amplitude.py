"""Amplitude of an oscillation."""

import numpy as np

from labrun.errors import ExperimentError
from labrun.objectives.channel import ChannelObjective
from labrun.objectives.protocol import Signal, TrialSignals


class Amplitude(ChannelObjective):
    """Amplitude of a channel: at the gait's frequency if there is one, else half of its range.

    At the gait's frequency it is the length of the first Fourier component over whole cycles, which noise and other
    frequencies do not enlarge as they do the range.
    """

    def __call__(self, signals: TrialSignals) -> float:
        """Return the amplitude, in the unit of `unit`."""
        signal = self._scaled(signals.counting(self.channel))
        if signals.period_s is None:
            return self._number(signal)
        span = signal.time_s[-1] - signal.time_s[0]
        turn = np.exp(-2j * np.pi * (signal.time_s - signal.time_s[0]) / signals.period_s)
        component = 2 / span * np.trapezoid((signal.values - signal.values.mean()) * turn, signal.time_s)
        if not np.isfinite(component):
            raise ExperimentError(f"{self.channel}: no amplitude at {1 / signals.period_s:.4g} Hz")
        return float(abs(component))

    def _number(self, signal: Signal) -> float:
        return float(np.ptp(signal.values) / 2)
