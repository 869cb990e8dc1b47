"""When a simulated sensor takes its samples, when they arrive, and which ones never do."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray


@dataclass(frozen=True, slots=True)
class Timing:
    """Time behaviour of a sensor.

    Attributes
    ----------
    latency_s
        From the sample to its receipt by the host, at least.
    jitter_s
        Mean of the further delay, which is exponentially distributed: most packets are hardly late, few are
        very late.
    lost_share
        Share of samples that never arrive.
    clock_offset_s, clock_drift
        Device time = (true time + offset) * (1 + drift).
    """

    latency_s: float
    jitter_s: float
    lost_share: float = 0.0
    clock_offset_s: float = 0.0
    clock_drift: float = 0.0


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Samples that arrived since the last look: true, device and host time, and how many got lost."""

    taken_s: FloatArray
    device_time_s: FloatArray
    host_time_s: FloatArray
    lost: int

    def __len__(self) -> int:
        return len(self.taken_s)


_NOTHING = np.empty(0)


@dataclass
class SampleStream:
    """The endless row of a sensor's samples, from `start` on; asked for what has arrived so far."""

    rate_hz: float
    timing: Timing
    _start_s: float = 0.0
    _next: int = 0
    _last_arrival_s: float = 0.0
    _under_way: tuple[NDArray[np.int64], FloatArray] = field(
        default_factory=lambda: (np.empty(0, dtype=np.int64), np.empty(0))
    )
    _last_seen: int = -1

    def start(self, now_s: float) -> None:
        """Begin at the first sample after now."""
        self._start_s = now_s
        self._next = 1
        self._last_seen = 0
        self._last_arrival_s = now_s
        self._under_way = (np.empty(0, dtype=np.int64), np.empty(0))

    def arrived(self, now_s: float, rng: np.random.Generator, extra_lost_share: float = 0.0) -> Arrivals:
        """Return what has been received up to now, and not been returned before."""
        # The small slack keeps a sample that falls on "now" from being decided by rounding.
        end = int((now_s - self._start_s) * self.rate_hz + 1e-6) + 1
        numbers, host_s = self._under_way
        if end > self._next:
            new_numbers = np.arange(self._next, end)
            self._next = end
            delay = self.timing.latency_s + rng.exponential(self.timing.jitter_s, len(new_numbers))
            arrival = np.maximum.accumulate(self._start_s + new_numbers / self.rate_hz + delay)
            np.maximum(arrival, self._last_arrival_s, out=arrival)
            self._last_arrival_s = float(arrival[-1])
            share = self.timing.lost_share + extra_lost_share
            if share > 0:
                kept = rng.random(len(new_numbers)) >= share
                new_numbers, arrival = new_numbers[kept], arrival[kept]
            numbers, host_s = np.concatenate([numbers, new_numbers]), np.concatenate([host_s, arrival])
        count = int(np.searchsorted(host_s, now_s, side="right"))
        self._under_way = (numbers[count:], host_s[count:])
        if count == 0:
            return Arrivals(_NOTHING, _NOTHING, _NOTHING, 0)
        numbers, host_s = numbers[:count], host_s[:count]
        last = int(numbers[-1])
        lost = last - self._last_seen - count
        self._last_seen = last
        taken = self._start_s + numbers / self.rate_hz
        device = (taken + self.timing.clock_offset_s) * (1 + self.timing.clock_drift)
        return Arrivals(taken, device, host_s, lost)
