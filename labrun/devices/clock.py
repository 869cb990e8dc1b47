"""Time as every part of labrun sees it."""

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
