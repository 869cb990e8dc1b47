"""Times of samples: device clocks mapped to the run's clock, and what that says about a stream."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labrun.arrays import FloatArray
from labrun.signals import Signals

WINDOW_S = 10.0
"""Length of device time of which the least delayed sample tells the clock offset."""
JUMP_S = 1.0
"""A device clock that gains more than this on the host between two samples was set or garbled."""


@dataclass(frozen=True, slots=True)
class StreamReport:
    """How well a device kept time in one trial.

    Attributes
    ----------
    rate_hz
        Mean rate of the samples that arrived and those known to be lost; NaN for fewer than two samples.
    jitter_s
        Standard deviation of the sample intervals, from the device's clock (gaps of lost samples left out).
    lost
        Samples that never arrived.
    offset_s
        Run clock minus device clock at the start of the stream.
    drift_ppm
        How fast the offset changes, parts per million; None where the trial is too short to tell.
    glitches
        Places where the device's time jumped, stood still or ran backwards.
    """

    rate_hz: float
    jitter_s: float
    lost: int
    offset_s: float
    drift_ppm: float | None
    glitches: int


class ClockMap:
    """Map of device time to host time, learned block by block in bounded memory.

    A sample cannot be received before it is made, so the least of (host - device) over a window is the clock
    offset plus the shortest transport delay. One such knot per window, linear between them, follows drift.
    Where the device's time steps back, or forward by more than `JUMP_S` beyond the host's, a new epoch with an
    offset of its own begins.
    """

    def __init__(self, rate_hz: float) -> None:
        self._least_step_s = 1e-3 / max(rate_hz, 1e-3)
        self._tie_step_s = 0.5 / max(rate_hz, 1e-3)
        self._starts: list[int] = []
        self._knots: list[list[tuple[float, float]]] = []
        self._window_end_s = -np.inf
        self._count = 0
        self._last_device_s = np.nan
        self._last_host_s = np.nan
        self._has_own_clock = False
        self.glitches = 0

    def learn(self, device_time_s: FloatArray, host_time_s: FloatArray) -> None:
        """Take in the next samples, in their order of arrival; both of shape (n,)."""
        if len(device_time_s) == 0:
            return
        self._has_own_clock |= not np.array_equal(device_time_s, host_time_s)
        device_step = np.diff(device_time_s, prepend=self._last_device_s)
        host_step = np.diff(host_time_s, prepend=self._last_host_s)
        jumps = (device_step < 0) | (device_step - host_step > JUMP_S)
        if self._has_own_clock:
            self.glitches += int(np.sum(jumps | (device_step == 0)))
        jumps[0] |= self._count == 0
        edges = np.append(np.flatnonzero(jumps), len(jumps))
        if edges[0] > 0:
            self._learn_epoch(device_time_s[: edges[0]], host_time_s[: edges[0]])
        for start, end in pairwise(edges):
            self._starts.append(self._count + int(start))
            self._knots.append([])
            self._window_end_s = -np.inf
            self._learn_epoch(device_time_s[start:end], host_time_s[start:end])
        self._count += len(device_time_s)
        self._last_device_s, self._last_host_s = float(device_time_s[-1]), float(host_time_s[-1])

    def _learn_epoch(self, device_time_s: FloatArray, host_time_s: FloatArray) -> None:
        knots = self._knots[-1]
        offset = host_time_s - device_time_s
        start = 0
        while start < len(offset):
            if device_time_s[start] >= self._window_end_s:
                self._window_end_s = float(device_time_s[start]) + WINDOW_S
                knots.append((float(device_time_s[start]), np.inf))
            end = int(np.searchsorted(device_time_s, self._window_end_s))
            best = start + int(np.argmin(offset[start:end]))
            if offset[best] < knots[-1][1]:
                knots[-1] = (float(device_time_s[best]), float(offset[best]))
            start = end

    @property
    def offset_s(self) -> float:
        """Run clock minus device clock in the first window; NaN before any sample."""
        return self._knots[0][0][1] if self._knots else np.nan

    @property
    def drift_ppm(self) -> float | None:
        """Change of the offset over the longest epoch, parts per million of device time; None below three windows."""
        knots = max(self._knots, key=len, default=[])
        if len(knots) < 3:
            return None
        time_s, offset_s = np.array(knots).T
        return float(np.polyfit(time_s - time_s[0], offset_s, 1)[0] * 1e6)

    def mapper(self, start_s: float) -> "TimeMapper":
        """Return what turns the samples learned, from the first on, into trial-relative times."""
        step = self._least_step_s if self._has_own_clock else self._tie_step_s
        return TimeMapper(self._starts, [np.array(knots).T for knots in self._knots], step, start_s)


class TimeMapper:
    """Trial-relative times of a stream, block by block from its first sample."""

    def __init__(
        self, starts: list[int], knots: list[FloatArray], least_step_s: float, start_s: float
    ) -> None:
        self._starts = starts
        self._knots = knots
        self._least_step_s = least_step_s
        self._start_s = start_s
        self._count = 0
        self._last_s = -np.inf

    def __call__(self, device_time_s: FloatArray) -> FloatArray:
        """Return strictly increasing times, shape (n,), s from the trial's start."""
        first, last = self._count, self._count + len(device_time_s)
        self._count = last
        if first == last:
            return np.empty(0)
        time_s = np.empty(len(device_time_s))
        epoch = int(np.searchsorted(self._starts, first, side="right")) - 1
        while epoch < len(self._starts) and self._starts[epoch] < last:
            begin = max(self._starts[epoch], first)
            end = min(self._starts[epoch + 1] if epoch + 1 < len(self._starts) else last, last)
            part = device_time_s[begin - first : end - first]
            knot_s, offset_s = self._knots[epoch]
            time_s[begin - first : end - first] = part + np.interp(part, knot_s, offset_s) - self._start_s
            epoch += 1
        return self._increasing(time_s)

    def _increasing(self, time_s: FloatArray) -> FloatArray:
        """Move a sample that does not come after its predecessor to the least step behind it."""
        if time_s[0] > self._last_s and (len(time_s) == 1 or np.diff(time_s).min() > 0):
            self._last_s = float(time_s[-1])
            return time_s
        ramp = self._least_step_s * np.arange(1, len(time_s) + 1)
        lifted: FloatArray = np.maximum.accumulate(np.maximum(time_s - ramp, self._last_s)) + ramp
        self._last_s = float(lifted[-1])
        return lifted


def stream_report(signals: Signals) -> StreamReport:
    """Tell rate, jitter, losses and clock of what one device measured in one trial."""
    clock = ClockMap(signals.rate_hz)
    if signals.device_time_s is not None and signals.host_time_s is not None:
        clock.learn(signals.device_time_s, signals.host_time_s)
    if len(signals) < 2:
        return StreamReport(np.nan, np.nan, signals.lost, clock.offset_s, None, clock.glitches)
    steps = np.diff(signals.time_s)
    typical = float(np.median(steps))
    rate_hz = (len(steps) + signals.lost) / float(signals.time_s[-1] - signals.time_s[0])
    regular = steps[steps < 1.5 * typical]
    return StreamReport(
        rate_hz, float(np.std(regular)), signals.lost, clock.offset_s, clock.drift_ppm, clock.glitches
    )
