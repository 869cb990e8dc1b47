"""When a simulated sensor takes its samples, when they arrive, and which ones never do."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray, Samples
from labrun.devices.compiled_bench import Ahead
from labrun.models import kernel

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
        delay = dice = _NOTHING
        timing = self.timing
        share = timing.lost_share + extra_lost_share
        first = self._next
        if end > first:
            delay = rng.exponential(timing.jitter_s, end - first)
            if share > 0:
                dice = rng.random(len(delay))
            self._next = end
        numbers, host_s, taken, device, arrived, self._last_arrival_s, last = _sent(
            *self._under_way, first, delay, timing.latency_s, dice, share, self._start_s, self.rate_hz,
            self._last_arrival_s, now_s, timing.clock_offset_s, timing.clock_drift,
        )  # fmt: skip
        self._under_way = (numbers, host_s)
        if len(arrived) == 0:
            return Arrivals(_NOTHING, _NOTHING, _NOTHING, 0)
        lost = last - self._last_seen - len(arrived)
        self._last_seen = last
        return Arrivals(taken, device, arrived, lost)

    def ahead(self, until_s: float, rng: np.random.Generator, extra_lost_share: float, draws: int) -> Ahead:
        """Return what arrives up to a time, with as many standard normal numbers for each sample."""
        here = self.arrived(until_s, rng, extra_lost_share)
        noise = rng.standard_normal((len(here), draws))
        return Ahead(here.taken_s, here.device_time_s, here.host_time_s, noise, here.lost)


class Delivered:
    """A block that a compiled dry run has measured already, until it is read."""

    def __init__(self) -> None:
        self._block: Samples | None = None

    def put(self, block: Samples) -> None:
        """Keep a block for the next read."""
        self._block = block

    def take(self) -> Samples | None:
        """Return it once; None if there is none."""
        block, self._block = self._block, None
        return block


@kernel
def _sent(
    numbers: IntArray, host_s: FloatArray, first: int, delay_s: FloatArray, latency_s: float, dice: FloatArray,
    lost_share: float, start_s: float, rate_hz: float, last_arrival_s: float, now_s: float, offset_s: float,
    drift: float,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray, float, int]:  # fmt: skip
    """Add samples from number `first` on to those under way, but for the lost ones; none overtakes another.

    Returned are numbers and arrival times of those still under way; true, device and host times of those that have
    arrived; when the last one will have arrived, and the number of the last that has.
    """
    waiting, new = len(numbers), len(delay_s)
    all_numbers, all_host_s = np.empty(waiting + new, np.int64), np.empty(waiting + new)
    for i in range(waiting):
        all_numbers[i] = numbers[i]
        all_host_s[i] = host_s[i]
    count = waiting
    for i in range(new):
        last_arrival_s = max(last_arrival_s, start_s + (first + i) / rate_hz + (latency_s + delay_s[i]))
        if lost_share <= 0.0 or dice[i] >= lost_share:
            all_numbers[count] = first + i
            all_host_s[count] = last_arrival_s
            count += 1
    here = 0
    while here < count and all_host_s[here] <= now_s:
        here += 1
    taken, device = np.empty(here), np.empty(here)
    for i in range(here):
        taken[i] = start_s + all_numbers[i] / rate_hz
        device[i] = (taken[i] + offset_s) * (1 + drift)
    last = all_numbers[here - 1] if here > 0 else -1
    return (
        all_numbers[here:count],
        all_host_s[here:count],
        taken,
        device,
        all_host_s[:here],
        last_arrival_s,
        last,
    )
