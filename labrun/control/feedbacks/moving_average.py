"""Mean over the last while."""

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import PositiveFloat

from labrun.control.feedbacks.channel import ChannelFeedback, FeedbackSettings, mean_over
from labrun.devices import FloatArray
from labrun.toml import checked


class MovingAverageSettings(FeedbackSettings):
    """Keys of `moving-average`: those of a channel, and the length of the window."""

    window_s: PositiveFloat


class MovingAverageFeedback(ChannelFeedback):
    """Mean over the last `window_s`; until so much is there, of what there is. It lags by half of its window."""

    Settings: ClassVar[type[FeedbackSettings]] = MovingAverageSettings

    def __init__(self, settings: Mapping[str, Any], units: Mapping[str, str]) -> None:
        super().__init__(settings, units)
        self._window_s = checked(MovingAverageSettings, settings).window_s

    def memory_s(self, period_s: float | None) -> float:  # noqa: ARG002
        """Return the window."""
        return self._window_s

    def _reduce(self, time_s: FloatArray, values: FloatArray, period_s: float | None) -> float:  # noqa: ARG002
        return mean_over(time_s, values, self._window_s)
