"""Clocks: the protocol, the host's, and a simulated one that costs nothing to wait on."""

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


class RealClock:
    """The host's monotonic clock; a `Clock`.

    For whoever has no run to get one from: a driver that probes a port, or stops an actuator whose runner died.
    """

    poll_s = 0.02

    def now(self) -> float:
        """Return the monotonic time, s."""
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        """Wait; zero or less returns at once."""
        if duration_s > 0:
            time.sleep(duration_s)


class SimulatedClock:
    """A clock that only moves when someone waits.

    Parameters
    ----------
    start_s
        Its time at the beginning, s.

    Attributes
    ----------
    time_s
        Its time, s; set to take up a run where it was left.
    """

    poll_s = 2.0
    """Coarse: nobody waits for it, and every look costs computing time."""

    def __init__(self, start_s: float = 0.0) -> None:
        self.time_s = start_s

    def now(self) -> float:
        """Return the simulated time, s."""
        return self.time_s

    def sleep(self, duration_s: float) -> None:
        """Move time on at once."""
        if duration_s > 0:
            self.time_s += duration_s
