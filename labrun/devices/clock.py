"""The protocol of a clock, and the host's."""

import time
from typing import Protocol


class Clock(Protocol):
    """The one source of time and of waiting.

    On hardware it is the host's monotonic clock; in a dry run it is simulated and `sleep` returns at once.
    """

    poll_s: float
    """How long the runner waits between two looks at its sensors."""

    def now(self) -> float:
        """Monotonic time in seconds; only differences mean something."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Wait; a duration of zero or less returns at once."""
        ...


class HostClock:
    """The host's monotonic clock; a `Clock`.

    For whoever has no run to get one from: a driver that probes a port, or stops an actuator whose runner died.

    Parameters
    ----------
    poll_s
        How long the runner waits between two looks at its sensors, s.
    """

    def __init__(self, poll_s: float = 0.02) -> None:
        self.poll_s = poll_s

    def now(self) -> float:
        """Return the monotonic time, s."""
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        """Wait; zero or less returns at once."""
        if duration_s > 0:
            time.sleep(duration_s)
