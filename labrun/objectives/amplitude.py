"""Amplitude of an oscillation."""

from collections.abc import Iterable

import numpy as np

from labrun.errors import ExperimentError
from labrun.objectives.channel import ChannelObjective
from labrun.objectives.protocol import TrialSignals
from labrun.signals import Signal


class Amplitude(ChannelObjective):
    """Amplitude of a channel: at the gait's frequency if there is one, else half of its range.

    At the gait's frequency it is the length of the first Fourier component over whole cycles, which noise and other
    frequencies do not enlarge as they do the range.
    """

    def __call__(self, signals: TrialSignals) -> float:
        """Return the amplitude, in the unit of `unit`."""
        if signals.period_s is None:
            return super().__call__(signals)
        mean = self._plain_mean(signals)
        start_s: float | None = None
        end_s, total = 0.0, 0j
        for piece in map(self._scaled, signals.counting_pieces(self.channel)):
            start_s, end_s = float(piece.time_s[0]) if start_s is None else start_s, float(piece.time_s[-1])
            turn = np.exp(-2j * np.pi * (piece.time_s - start_s) / signals.period_s)
            total += complex(np.trapezoid((piece.values - mean) * turn, piece.time_s))
        component = 2 / (end_s - (start_s or 0.0)) * total
        if not np.isfinite(component):
            raise ExperimentError(f"{self.channel}: no amplitude at {1 / signals.period_s:.4g} Hz")
        return float(abs(component))

    def _plain_mean(self, signals: TrialSignals) -> float:
        total, count = 0.0, 0
        for piece in map(self._scaled, signals.counting_pieces(self.channel)):
            values = piece.values[min(count, 1) :]  # the first of a later piece has been counted
            total, count = total + float(values.sum()), count + len(values)
        return total / count

    def _number(self, pieces: Iterable[Signal]) -> float:
        ends = [(piece.values.min(), piece.values.max()) for piece in pieces]
        return float((max(high for _, high in ends) - min(low for low, _ in ends)) / 2)
