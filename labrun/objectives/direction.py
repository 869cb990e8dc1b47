"""Direction of a force in the plane."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from labrun.errors import ExperimentError
from labrun.objectives.channel import ChannelObjective, ChannelSettings, time_mean
from labrun.objectives.protocol import TrialSignals
from labrun.signals import Signal


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

    def __init__(self, channel: str | None, settings: Mapping[str, Any]) -> None:
        super().__init__(channel, settings)
        keys = DirectionSettings.model_validate(dict(settings))
        self.side_channel, self._side_scale = keys.side_channel, keys.side_scale

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return "deg": an angle, whatever the channels are."""
        return "deg"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the angle, deg, in (-180, 180].

        Raises
        ------
        ExperimentError
            Both means are zero: there is no direction.
        """
        forward = self._number(signals.counting_pieces(self.channel)) * self._settings.scale
        side = self._number(signals.counting_pieces(self.side_channel)) * self._side_scale
        if forward == 0 and side == 0:
            raise ExperimentError(f"{self.channel} and {self.side_channel} are both zero: no direction")
        return math.degrees(math.atan2(side, forward))

    def _number(self, pieces: Iterable[Signal]) -> float:
        return time_mean(pieces)
