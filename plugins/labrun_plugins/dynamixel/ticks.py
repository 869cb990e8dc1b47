"""The clock of a servo, which counts milliseconds and starts anew every 32.768 s."""

import math
from collections import deque

from labrun_plugins.dynamixel.control_table import TICK_PERIOD_S

_WINDOW_S = 5.0
"""The two clocks drift apart by less than a millisecond in this time."""


class TickClock:
    """Follows one servo's ticks."""

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._least: deque[tuple[float, float]] = deque()
        """Offsets that may still become the least one: each is greater than those before it."""

    def at(self, tick_ms: int, received_s: float) -> tuple[float, float]:
        """Return the servo's own time of an answer, and how much later than the quickest ones it arrived.

        Parameters
        ----------
        tick_ms
            What the answer says.
        received_s
            When it arrived, by the host's clock.

        Returns
        -------
        device_s, late_s : float
            Time by the servo's clock, which goes on where the count starts anew, and the answer's lateness compared
            with the least delayed one of the last seconds.
        """
        device_s = 1e-3 * tick_ms
        if self._last is not None:
            last_device_s, last_received_s = self._last
            expected_s = last_device_s + received_s - last_received_s
            device_s += TICK_PERIOD_S * math.floor((expected_s - device_s) / TICK_PERIOD_S + 0.5)
        offset_s = received_s - device_s
        while self._least and self._least[0][0] < received_s - _WINDOW_S:
            self._least.popleft()
        while self._least and self._least[-1][1] >= offset_s:
            self._least.pop()
        self._least.append((received_s, offset_s))
        self._last = (device_s, received_s)
        return device_s, offset_s - self._least[0][1]
