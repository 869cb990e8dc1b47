"""Extremes of a channel in each cycle, and how sure they are; the share of the time a channel spends beyond a level."""

import math
from collections.abc import Iterable
from typing import ClassVar, Literal

import numpy as np
from pydantic import NonNegativeFloat, model_validator

from labrun.arrays import FloatArray
from labrun.errors import ExperimentError
from labrun.objectives.channel import ChannelObjective, ChannelSettings, Following, ReducedChannel
from labrun.objectives.protocol import TrialSignals
from labrun.signals import Signal
from labrun.toml import TableFaults


class ExtremesSettings(ChannelSettings):
    """Keys of `extremes`.

    Attributes
    ----------
    which
        The "largest" or the "smallest" value of each cycle, or its "range", largest less smallest.
    give
        The "mean" of the cycles; or "ci95", half the width of its 95 % interval over cycles (Student's t).
    smooth_s
        The channel is averaged over so long a time first: noise adds to every extreme. Much shorter than the peak.
    """

    which: Literal["largest", "smallest", "range"] = "largest"
    give: Literal["mean", "ci95"] = "mean"
    smooth_s: NonNegativeFloat = 0.0


class Extremes(ChannelObjective):
    """Extreme of a channel in each cycle, its mean over cycles or the interval of that.

    A trial without cycles is one cycle; it has no interval.
    """

    Settings: ClassVar[type[ChannelSettings]] = ExtremesSettings
    _settings: ExtremesSettings

    @property
    def offset_free(self) -> bool:
        """Tell whether a constant offset of the channel does not change the number."""
        return self._settings.which == "range" or self._settings.give == "ci95"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the number.

        Raises ExperimentError: an interval over fewer than two cycles, or a cycle without samples.
        """
        keys = self._settings
        start_s, end_s = signals.window()
        period_s = signals.period_s or end_s - start_s
        count = max(round((end_s - start_s) / period_s), 1)
        high, low = np.full(count, -np.inf), np.full(count, np.inf)
        for piece in map(self._scaled, signals.counting_pieces(self.channel)):
            values = smoothed(piece.time_s, piece.values, keys.smooth_s)
            cycle = np.clip(((piece.time_s - start_s) / period_s).astype(int), 0, count - 1)
            np.maximum.at(high, cycle, values)
            np.minimum.at(low, cycle, values)
        extreme = {"largest": high, "smallest": low, "range": high - low}[keys.which]
        if not np.isfinite(extreme).all():
            raise ExperimentError(f"{self.channel} has a cycle without samples")
        if keys.give == "mean":
            return float(extreme.mean())
        if count < 2:
            raise ExperimentError(
                f"{self.channel}: an interval over cycles needs two of them",
                hint="raise trial.cycles, or give a gait with a cycle",
            )
        from scipy.stats import t as student

        return float(student.ppf(0.975, count - 1) * extreme.std(ddof=1) / math.sqrt(count))


def smoothed(time_s: FloatArray, values: FloatArray, over_s: float) -> FloatArray:
    """Return the mean of straight lines between samples over a time around each; shorter at the ends.

    Parameters
    ----------
    time_s, values : (n,)
    over_s
        0 changes nothing.
    """
    if over_s == 0.0 or len(values) < 2:
        return values
    area = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time_s))])
    half = np.minimum(0.5 * over_s, np.minimum(time_s - time_s[0], time_s[-1] - time_s))
    wide = half > 0.0
    low, high = time_s - half, time_s + half
    mean = (_integral(high, time_s, values, area) - _integral(low, time_s, values, area)) / np.where(
        wide, 2.0 * half, 1.0
    )
    return np.where(wide, mean, values)


def _integral(at_s: FloatArray, time_s: FloatArray, values: FloatArray, area: FloatArray) -> FloatArray:
    """Return the integral of straight lines between samples from the first one on."""
    index = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(time_s) - 2)
    passed = at_s - time_s[index]
    slope = (values[index + 1] - values[index]) / (time_s[index + 1] - time_s[index])
    integral: FloatArray = area[index] + passed * (values[index] + 0.5 * slope * passed)
    return integral


class ShareOfTimeSettings(ChannelSettings):
    """Keys of `share-of-time`.

    Attributes
    ----------
    above, below
        A level in the channel's SI unit, after `scale`; one of them.
    less
        A second channel, which is subtracted first: of two angles the joint between them.
    """

    above: float | None = None
    below: float | None = None
    less: str | None = None

    @model_validator(mode="after")
    def _one_level(self) -> "ShareOfTimeSettings":
        with TableFaults() as faults:
            if (self.above is None) == (self.below is None):
                faults.add("above", "give one of above and below", of=("above", "below"))
        return self


class ShareOfTime(ReducedChannel):
    """Share of the time that a channel spends above, or below, a level, %; over whole cycles where there are any."""

    Settings: ClassVar[type[ChannelSettings]] = ShareOfTimeSettings
    channel_settings: ClassVar[tuple[str, ...]] = ("less",)
    _settings: ShareOfTimeSettings

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return "%"."""
        return "%"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the share."""
        pieces = signals.counting_pieces(self.channel)
        if self._settings.less is None:
            return self._number(map(self._scaled, pieces))
        other = Following(signals.counting_pieces(self._settings.less))
        return self._number(
            self._scaled(Signal(piece.time_s, piece.values - other.at(piece.time_s), piece.unit))
            for piece in pieces
        )

    def _number(self, pieces: Iterable[Signal]) -> float:
        above, below = self._settings.above, self._settings.below
        inside = whole = 0.0
        for piece in pieces:
            over = piece.values - above if above is not None else (below or 0.0) - piece.values
            first, last = over[:-1], over[1:]
            rise = np.abs(first) + np.abs(last)
            # straight between samples: of an interval that crosses the level, the part on the right side of it
            share = np.where(
                first * last < 0.0,
                np.maximum(first, last) / np.where(rise > 0.0, rise, 1.0),
                (first + last) > 0.0,
            )
            steps = np.diff(piece.time_s)
            inside, whole = inside + float(share @ steps), whole + float(steps.sum())
        return 100.0 * inside / whole
