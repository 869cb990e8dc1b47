"""The host's clock, for a driver that is called without a run: to probe a port, or to stop an orphaned actuator."""

import time


class HostClock:
    """The host's monotonic clock; a `Clock`."""

    poll_s = 0.02

    def now(self) -> float:
        """Return the monotonic time, s."""
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        """Wait; zero or less returns at once."""
        if duration_s > 0:
            time.sleep(duration_s)
