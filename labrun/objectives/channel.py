"""Objectives of one channel: mean (over cycles, in magnitude), peak, amplitude, direction with another."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from typing import Any, ClassVar

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat, model_validator

from labrun.arrays import FloatArray
from labrun.errors import ExperimentError, SpecError
from labrun.objectives.protocol import TrialSignals
from labrun.objectives.window import truncation_bound
from labrun.signals import Signal
from labrun.toml import Table, TableFaults, checked


class ChannelSettings(Table):
    """Keys of an objective of one channel.

    Attributes
    ----------
    scale
        The channel is multiplied by it first, to turn it round (-1) or take a share of it.
    divide_by_m
        The channel is divided by this length, m: a torque at the end of a bar becomes the force that made it.
    """

    scale: float = 1.0
    divide_by_m: PositiveFloat | None = None


class ChannelObjective(ABC):
    """A number from one channel.

    Parameters
    ----------
    channel
        "device.channel".
    settings
        Keys of `ChannelSettings`.

    Raises
    ------
    SpecError
        No channel, or keys that do not hold.
    """

    Settings: ClassVar[type[ChannelSettings]] = ChannelSettings
    _settings: ChannelSettings
    needs_channel: ClassVar[bool] = True

    def __init__(self, channel: str | None, settings: Mapping[str, Any]) -> None:
        if channel is None:
            raise SpecError('the key "channel" is missing: name the channel to evaluate')
        self.channel = channel
        self._settings = checked(self.Settings, settings)

    def unit(self, channel_unit: str) -> str:
        """Return the number's unit: that of the channel, divided by metres where the file asks for it."""
        return per_metre(channel_unit) if self._settings.divide_by_m is not None else channel_unit

    @abstractmethod
    def __call__(self, signals: TrialSignals) -> float:
        """Return the number."""

    @property
    def _factor(self) -> float:
        return self._settings.scale / (self._settings.divide_by_m or 1.0)

    def _scaled(self, signal: Signal) -> Signal:
        return Signal(signal.time_s, signal.values * self._factor, self.unit(signal.unit))


class ReducedChannel(ChannelObjective):
    """A number from one channel, which the counting part of it is enough for."""

    def __call__(self, signals: TrialSignals) -> float:
        """Return the number."""
        return self._number(map(self._scaled, signals.counting_pieces(self.channel)))

    @abstractmethod
    def _number(self, pieces: Iterable[Signal]) -> float:
        """Reduce the counting part of the channel to one number; each piece begins with the last sample before it."""


def per_metre(unit: str) -> str:
    """Return a unit divided by metres: "N" for "N m"; an unknown unit, "", stays unknown."""
    if not unit:
        return ""
    return unit.removesuffix(" m") if unit.endswith(" m") else f"{unit}/m"


def time_mean(pieces: Iterable[Signal], of: Callable[[FloatArray], FloatArray] = np.asarray) -> float:
    """Return the mean over time (trapezoidal rule); missing samples do not shift it as they would a plain mean.

    `pieces`: at least one; each begins with the last sample of the one before. `of`: what of the values is meant, for
    example their magnitude.
    """
    parts: list[float] = []
    start_s = end_s = 0.0
    for piece in pieces:
        if not parts:
            start_s = piece.time_s[0]
        parts.append(float(np.trapezoid(of(piece.values), piece.time_s)))
        end_s = piece.time_s[-1]
    return math.fsum(parts) / float(end_s - start_s)


class Following:
    """A second channel at the times of the first, both taken piece by piece."""

    def __init__(self, pieces: Iterator[Signal]) -> None:
        self._pieces = pieces
        self._time_s, self._values = np.empty(0), np.empty(0)

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return its values at ascending times, each call's not before the last one's; straight between samples."""
        while not len(self._time_s) or self._time_s[-1] < time_s[-1]:
            piece = next(self._pieces, None)
            if piece is None:
                break
            kept = self._time_s >= time_s[0] - 1.0
            self._time_s = np.concatenate([self._time_s[kept], piece.time_s])
            self._values = np.concatenate([self._values[kept], piece.values])
        following: FloatArray = np.interp(time_s, self._time_s, self._values)
        return following


class Mean(ReducedChannel):
    """Mean of a channel over the recording; over its whole cycles after the discarded ones if the gait has any."""

    def truncation(self, signals: TrialSignals) -> float:
        """Return a bound of what cut cycles add or take; 0 where the file does not ask for an `average`."""
        if signals.average is None:
            return 0.0
        counting = self._scaled(signals.counting(self.channel))
        return truncation_bound(counting, signals.frequencies_hz.values())

    def _number(self, pieces: Iterable[Signal]) -> float:
        return time_mean(pieces)


class CycleMean(Mean):
    """Mean of a channel over whole gait cycles after the discarded ones, or over what `trial.average` says.

    Cut to whole cycles, so that what a symmetric gait does to and fro cancels (the source's own sanity check on side
    force); integrated over time, so that lost samples do not weight the rest of the cycle.
    """

    def __call__(self, signals: TrialSignals) -> float:
        """Return the mean, in the unit of `unit`.

        Raises ExperimentError: the gait has no cycle, or the recording holds no whole one.
        """
        if signals.period_s is None and signals.average is None:
            raise ExperimentError(
                f"{self.channel}: cycle-mean needs a gait with a cycle",
                hint='give the gait a frequency_hz, average over beats (trial.average), or use plugin = "mean"',
            )
        return super().__call__(signals)


class MeanAbsoluteSettings(ChannelSettings):
    """Keys of `mean-absolute`: `from_s` and `to_s` narrow the part of the recording that counts."""

    from_s: NonNegativeFloat | None = None
    to_s: NonNegativeFloat | None = None

    @model_validator(mode="after")
    def _ordered(self) -> "MeanAbsoluteSettings":
        with TableFaults() as faults:
            if self.from_s is not None and self.to_s is not None and not self.from_s < self.to_s:
                faults.add(
                    "to_s", f"{self.to_s:g} s is not after from_s = {self.from_s:g} s", of=("from_s", "to_s")
                )
        return self


class MeanAbsolute(ReducedChannel):
    """Mean over time of a channel's magnitude: of an error, how far off a loop was on average (MAE).

    Without `from_s` and `to_s` it counts what every objective counts: the recording after the discarded cycles.
    """

    Settings: ClassVar[type[ChannelSettings]] = MeanAbsoluteSettings
    _settings: MeanAbsoluteSettings

    def __call__(self, signals: TrialSignals) -> float:
        """Return the mean, in the unit of `unit`.

        Raises ExperimentError: fewer than two samples lie between `from_s` and `to_s`.
        """
        # A stated end need not be that of a gait cycle: up to there, the whole recording counts.
        from_s, to_s = self._settings.from_s, self._settings.to_s
        start_s, end_s = signals.window() if to_s is None else (signals.start_s, signals.end_s)
        start_s = start_s if from_s is None else max(start_s, from_s)
        end_s = end_s if to_s is None else min(end_s, to_s)
        whole = signals.counting_pieces if to_s is None else signals.pieces
        parts = (piece.between(start_s, end_s) for piece in whole(self.channel))
        first = next((part for part in parts if len(part.time_s) > 1), None)
        if first is None:
            raise ExperimentError(
                f"{self.channel} has fewer than 2 samples between {start_s:.4g} and {end_s:.4g} s",
                hint=f"the recording lasts {signals.end_s - signals.start_s:.4g} s: check from_s and to_s",
            )
        rest = (part for part in parts if len(part.time_s) > 1)
        return self._number(map(self._scaled, chain([first], rest)))

    def _number(self, pieces: Iterable[Signal]) -> float:
        return time_mean(pieces, np.abs)


class Rms(ReducedChannel):
    """Root of the mean square of a channel over the recording, mean included, integrated over time."""

    def _number(self, pieces: Iterable[Signal]) -> float:
        return math.sqrt(time_mean(pieces, np.square))


class Peak(ReducedChannel):
    """The value of a channel that is farthest from zero, with its sign."""

    def _number(self, pieces: Iterable[Signal]) -> float:
        peaks = (float(piece.values[np.argmax(np.abs(piece.values))]) for piece in pieces)
        return max(peaks, key=abs)


class Amplitude(ReducedChannel):
    """Amplitude of a channel: at the gait's frequency if there is one, else half of its range.

    At the gait's frequency it is the length of the first Fourier component over whole cycles, which noise and other
    frequencies do not enlarge as they do the range.
    """

    offset_free: ClassVar[bool] = True

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


class LoopAreaSettings(ChannelSettings):
    """Keys of `loop-area`: `over` is the channel along which the other does its work."""

    over: str


class LoopArea(ChannelObjective):
    """Area between the way there and the way back of one channel over another: the work of a cycle, J.

    Of force over displacement or of torque over angle it is what the specimen does not give back.
    """

    Settings: ClassVar[type[ChannelSettings]] = LoopAreaSettings
    channel_settings: ClassVar[tuple[str, ...]] = ("over",)
    offset_free: ClassVar[bool] = True
    _settings: LoopAreaSettings

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return "J": force over metres, or torque over radians."""
        return "J"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the area."""
        total = 0.0
        over = signals.counting_pieces(self._settings.over)
        for piece, along in zip(signals.counting_pieces(self.channel), over, strict=True):
            force = self._scaled(piece)
            way = np.interp(force.time_s, along.time_s, along.values)
            total += float(np.trapezoid(force.values, way))
        return total


class DirectionSettings(ChannelSettings):
    """Keys of `direction`: `side_channel` is the second axis, and `side_scale` turns it round (-1) or weights it."""

    side_channel: str
    side_scale: float = 1.0


class Direction(ChannelObjective):
    """Angle of the mean force vector of two channels, deg: 0 along `channel`, +90 along `side_channel`.

    Source, section 5: direction is the angle of the vector of forward and side force.
    """

    Settings: ClassVar[type[ChannelSettings]] = DirectionSettings
    channel_settings: ClassVar[tuple[str, ...]] = ("side_channel",)
    _settings: DirectionSettings

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return "deg": an angle, whatever the channels are."""
        return "deg"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the angle, deg, in (-180, 180]. Raises ExperimentError: both means are zero: there is no direction."""
        keys = self._settings
        forward = time_mean(signals.counting_pieces(self.channel)) * keys.scale
        side = time_mean(signals.counting_pieces(keys.side_channel)) * keys.side_scale
        if forward == 0 and side == 0:
            raise ExperimentError(f"{self.channel} and {keys.side_channel} are both zero: no direction")
        return math.degrees(math.atan2(side, forward))


class Cycles:
    """Number of whole cycles that count, or that a trial with `until` lasted."""

    needs_channel: ClassVar[bool] = False

    def __init__(self, channel: str | None, settings: Mapping[str, Any]) -> None:
        if channel is not None or settings:
            raise SpecError('"cycles" takes neither a channel nor keys of its own: it counts')

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return "1"."""
        return "1"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the number of cycles. Raises ExperimentError: the motion has none."""
        if signals.period_s is None:
            raise ExperimentError("the motion has no cycle to count")
        start_s, end_s = signals.window()
        return float(round((end_s - start_s) / signals.period_s))
