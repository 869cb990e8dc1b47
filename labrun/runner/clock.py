"""The two clocks: the host's, and a simulated one that costs nothing to wait on."""

from labrun.devices.clock import HostClock as RealClock

__all__ = ["RealClock", "SimulatedClock"]


class SimulatedClock:
    """A clock that only moves when someone waits.

    Parameters
    ----------
    start_s
        Its time at the beginning, s.
    poll_s
        As of `RealClock`, but coarse: nobody waits for it, and every look costs computing time.

    Attributes
    ----------
    time_s
        Its time, s; set to take up a run where it was left.
    """

    def __init__(self, start_s: float = 0.0, poll_s: float = 2.0) -> None:
        self.time_s = start_s
        self.poll_s = poll_s

    def now(self) -> float:
        """Return the simulated time, s."""
        return self.time_s

    def sleep(self, duration_s: float) -> None:
        """Move time on at once."""
        if duration_s > 0:
            self.time_s += duration_s
