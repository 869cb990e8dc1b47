"""The newest sample."""

from labrun.control.feedbacks.channel import ChannelFeedback
from labrun.devices import FloatArray


class LatestFeedback(ChannelFeedback):
    """The newest sample of a channel, as it is: for a sensor that is quiet, or filters itself."""

    def memory_s(self, period_s: float | None) -> float:  # noqa: ARG002
        """Return 0: nothing but the newest counts."""
        return 0.0

    def _reduce(self, time_s: FloatArray, values: FloatArray, period_s: float | None) -> float:  # noqa: ARG002
        return float(values[-1])
