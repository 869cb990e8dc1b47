"""Mean over the last gait cycle."""

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import PositiveFloat

from labrun.control.feedbacks.channel import ChannelFeedback, FeedbackSettings, mean_over
from labrun.devices import FloatArray
from labrun.errors import SpecError
from labrun.toml import checked


class CycleAverageSettings(FeedbackSettings):
    """Keys of `cycle-average`: those of a channel, and a cycle's length where the gait has none of its own."""

    period_s: PositiveFloat | None = None


class CycleAverageFeedback(ChannelFeedback):
    """Mean over exactly the last whole gait cycle (source, section 5.1): what a fin does to and fro cancels.

    Before one cycle is over, the mean of what there is. It lags by half a cycle.
    """

    Settings: ClassVar[type[FeedbackSettings]] = CycleAverageSettings

    def __init__(self, settings: Mapping[str, Any], units: Mapping[str, str]) -> None:
        super().__init__(settings, units)
        self._period_s = checked(CycleAverageSettings, settings).period_s

    @staticmethod
    def needs_cycle(settings: Mapping[str, Any]) -> bool:
        """Tell that the gait must repeat, unless a period is given."""
        return "period_s" not in settings

    def memory_s(self, period_s: float | None) -> float:
        """Return one cycle.

        Raises
        ------
        SpecError
            Neither the gait nor the feedback has a cycle.
        """
        return self._cycle_s(period_s)

    def _reduce(self, time_s: FloatArray, values: FloatArray, period_s: float | None) -> float:
        return mean_over(time_s, values, self._cycle_s(period_s))

    def _cycle_s(self, period_s: float | None) -> float:
        cycle_s = self._period_s or period_s
        if cycle_s is None:
            raise SpecError(
                "cycle-average needs a gait with a cycle", hint="give it period_s, or use moving-average"
            )
        return cycle_s
