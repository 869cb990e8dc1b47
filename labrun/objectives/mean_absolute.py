"""Mean of the magnitude."""

from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, model_validator

from labrun.errors import ExperimentError
from labrun.objectives.channel import ChannelObjective, ChannelSettings, time_mean
from labrun.objectives.protocol import TrialSignals
from labrun.signals import Signal
from labrun.toml import Faults

Seconds = Annotated[float, Field(ge=0)]


class MeanAbsoluteSettings(ChannelSettings):
    """Keys of `mean-absolute`: `from_s` and `to_s` narrow the part of the recording that counts."""

    from_s: Seconds | None = None
    to_s: Seconds | None = None

    @model_validator(mode="after")
    def _ordered(self) -> "MeanAbsoluteSettings":
        with Faults() as faults:
            if self.from_s is not None and self.to_s is not None and not self.from_s < self.to_s:
                faults.add(
                    "to_s", f"{self.to_s:g} s is not after from_s = {self.from_s:g} s", of=("from_s", "to_s")
                )
        return self


class MeanAbsolute(ChannelObjective):
    """Mean over time of a channel's magnitude: of an error, how far off a loop was on average (MAE).

    Without `from_s` and `to_s` it counts what every objective counts: the recording after the discarded cycles.
    """

    Settings: ClassVar[type[ChannelSettings]] = MeanAbsoluteSettings

    def __init__(self, channel: str | None, settings: Mapping[str, Any]) -> None:
        super().__init__(channel, settings)
        keys = MeanAbsoluteSettings.model_validate(dict(settings))
        self._from_s, self._to_s = keys.from_s, keys.to_s

    def __call__(self, signals: TrialSignals) -> float:
        """Return the mean, in the unit of `unit`.

        Raises
        ------
        ExperimentError
            Fewer than two samples lie between `from_s` and `to_s`.
        """
        # A stated end need not be that of a gait cycle: up to there, the whole recording counts.
        start_s, end_s = (signals.start_s, signals.end_s) if self._to_s is not None else signals.window()
        start_s = start_s if self._from_s is None else max(start_s, self._from_s)
        end_s = end_s if self._to_s is None else min(end_s, self._to_s)
        whole = signals.counting_pieces if self._to_s is None else signals.pieces
        parts = (piece.between(start_s, end_s) for piece in whole(self.channel))
        first = next((part for part in parts if len(part.time_s) > 1), None)
        if first is None:
            raise ExperimentError(
                f"{self.channel} has fewer than 2 samples between {start_s:.4g} and {end_s:.4g} s",
                hint=f"the recording lasts {signals.end_s - signals.start_s:.4g} s: look at from_s and to_s",
            )
        rest = (part for part in parts if len(part.time_s) > 1)
        return self._number(map(self._scaled, chain([first], rest)))

    def _number(self, pieces: Iterable[Signal]) -> float:
        return time_mean(pieces, np.abs)
