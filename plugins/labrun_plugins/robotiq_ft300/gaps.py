"""How many frames a stream without counter and time stamps has lost, judged by when the others came."""

import math


class GapCounter:
    """Estimates lost frames from receive times.

    Frames leave the sensor on a regular grid and come some time after it. The least late frame of each stretch of
    `window` frames says where the grid stands: if even that one is late by n periods, n frames are missing. A host that
    was busy for a while is not mistaken for a loss, since the frames it then finds all at once end on the grid again;
    nor is a sensor whose clock is off by up to half a period a stretch (2 % with 25 frames).

    Parameters
    ----------
    period_s
        Of the grid.
    window
        Frames a stretch: losses are told by the end of the next stretch.
    """

    def __init__(self, period_s: float, window: int = 25) -> None:
        self._period_s = period_s
        self._window = window
        self._next_s: float | None = None
        self._heard = 0
        self._least_late_s = math.inf

    def hear(self, time_s: float) -> int:
        """Take the receive time of one frame; return how many losses that has brought to light."""
        if self._next_s is None:
            self._next_s = time_s + self._period_s
            return 0
        late_s = time_s - self._next_s
        self._next_s += self._period_s
        if late_s < 0.0:  # the earliest so far: the grid stands further ahead than it seemed
            self._next_s += late_s
            late_s = 0.0
        self._least_late_s = min(self._least_late_s, late_s)
        self._heard += 1
        return self.settle() if self._heard >= self._window else 0

    def settle(self) -> int:
        """Judge by the frames since the last time, though they may be few; return the losses found."""
        if self._next_s is None or self._heard < 3:
            return 0
        lost = round(self._least_late_s / self._period_s)
        self._next_s += self._least_late_s
        self._heard = 0
        self._least_late_s = math.inf
        return lost
