"""When a simulated sensor takes its samples, when they arrive, and which ones never do."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray
from labrun.models.calling import kernel

IntArray = NDArray[np.int64]


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
    _under_way: tuple[IntArray, FloatArray] = field(
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
            delay = self.timing.latency_s + rng.exponential(self.timing.jitter_s, end - self._next)
            share = self.timing.lost_share + extra_lost_share
            dice = rng.random(len(delay)) if share > 0 else np.ones(len(delay))
            numbers, host_s, self._last_arrival_s = _sent(
                numbers,
                host_s,
                self._next,
                delay,
                dice,
                share,
                self._start_s,
                self.rate_hz,
                self._last_arrival_s,
            )
            self._next = end
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


@kernel
def _sent(
    numbers: IntArray, host_s: FloatArray, first: int, delay_s: FloatArray, dice: FloatArray, lost_share: float,
    start_s: float, rate_hz: float, last_arrival_s: float,
) -> tuple[IntArray, FloatArray, float]:  # fmt: skip
    """Add samples from number `first` on to those under way, but for the lost ones; none overtakes another."""
    waiting, new = len(numbers), len(delay_s)
    all_numbers, all_host_s = np.empty(waiting + new, np.int64), np.empty(waiting + new)
    for i in range(waiting):
        all_numbers[i] = numbers[i]
        all_host_s[i] = host_s[i]
    count = waiting
    for i in range(new):
        last_arrival_s = max(last_arrival_s, start_s + (first + i) / rate_hz + delay_s[i])
        if dice[i] >= lost_share:
            all_numbers[count] = first + i
            all_host_s[count] = last_arrival_s
            count += 1
    return all_numbers[:count], all_host_s[:count], last_arrival_s
