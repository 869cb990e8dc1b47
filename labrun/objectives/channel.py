"""What the objectives of one channel share."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, ClassVar, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from labrun.devices import FloatArray
from labrun.errors import SpecError
from labrun.objectives.protocol import TrialSignals
from labrun.signals import Signal
from labrun.toml import dotted, validate


class ChannelSettings(BaseModel):
    """Keys of an objective of one channel.

    Attributes
    ----------
    scale
        The channel is multiplied by it first, to turn it round (-1) or take a share of it.
    divide_by_m
        The channel is divided by this length, m: a torque at the end of a bar becomes the force that made it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    scale: float = 1.0
    divide_by_m: Annotated[float, Field(gt=0)] | None = None


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
    needs_channel: ClassVar[bool] = True

    def __init__(self, channel: str | None, settings: Mapping[str, Any]) -> None:
        if channel is None:
            raise SpecError('the key "channel" is missing: which channel this number is made of')
        checked, problems = validate(self.Settings, settings)
        if problems:
            raise SpecError("; ".join(f"{dotted(item.path)}: {item.message}" for item in problems))
        self.channel = channel
        self._settings = cast("ChannelSettings", checked)

    def unit(self, channel_unit: str) -> str:
        """Return the number's unit: that of the channel, divided by metres where the file asks for it."""
        return per_metre(channel_unit) if self._settings.divide_by_m is not None else channel_unit

    def __call__(self, signals: TrialSignals) -> float:
        """Return the number."""
        return self._number(map(self._scaled, signals.counting_pieces(self.channel)))

    def _scaled(self, signal: Signal) -> Signal:
        factor = self._settings.scale / (self._settings.divide_by_m or 1.0)
        return Signal(signal.time_s, signal.values * factor, self.unit(signal.unit))

    @abstractmethod
    def _number(self, pieces: Iterable[Signal]) -> float:
        """Reduce the counting part of the channel to one number; each piece begins with the last sample before it."""


def per_metre(unit: str) -> str:
    """Return a unit divided by metres: "N" for "N m"."""
    return unit.removesuffix(" m") if unit.endswith(" m") else f"{unit}/m"


def time_mean(pieces: Iterable[Signal], of: Callable[[FloatArray], FloatArray] = np.asarray) -> float:
    """Return the mean over time (trapezoidal rule); missing samples do not shift it as they would a plain mean.

    Parameters
    ----------
    pieces
        At least one; each begins with the last sample of the one before.
    of
        What of the values is meant, for example their magnitude.
    """
    parts: list[float] = []
    start_s = end_s = 0.0
    for piece in pieces:
        if not parts:
            start_s = piece.time_s[0]
        parts.append(float(np.trapezoid(of(piece.values), piece.time_s)))
        end_s = piece.time_s[-1]
    return math.fsum(parts) / float(end_s - start_s)
