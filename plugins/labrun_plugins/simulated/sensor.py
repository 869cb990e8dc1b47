"""A simulated sensor: when it takes samples, when they arrive, with noise, quantization, range, losses and latency."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labrun.devices import Channel, DeviceContext, DeviceError, FloatArray, Samples, streaming
from labrun.models import kernel
from labrun_plugins.simulated.device import SimulatedDevice, SimulatedSettings

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


_SILENCE_S = 0.5
_SILENT_SAMPLES = 3
"""A driver takes a stream that is silent for this long, and for so many samples, as lost."""


class SimulatedSensor(SimulatedDevice, ABC):
    """Streams what `_measure` makes of the scene.

    Parameters
    ----------
    channels
        What it measures.
    rate_hz
        True sample rate.
    timing
        Latency, jitter, losses and clock.
    full_scale : (channels,)
        End of the measuring range of each channel; infinite where there is none.
    counts_frames
        Whether the device numbers its samples, so that a driver can count the lost ones.
    has_clock
        Whether the device stamps its samples; without, the device time repeats the host time.
    """

    def __init__(
        self,
        name: str,
        settings: SimulatedSettings,
        context: DeviceContext,
        *,
        channels: tuple[Channel, ...],
        rate_hz: float,
        timing: Timing,
        full_scale: FloatArray,
        counts_frames: bool = True,
        has_clock: bool = True,
    ) -> None:
        super().__init__(name, settings, context)
        self.channels = channels
        self.rate_hz = rate_hz
        self._stream = SampleStream(rate_hz, timing)
        self._full_scale = full_scale
        self._bounded = bool(np.isfinite(full_scale).any())
        self._disturbed = self._faults.saturate or self._faults.nonsense_after_s is not None
        self._counts_frames = counts_frames
        self._has_clock = has_clock
        self._streaming = False
        self._last_heard_s = 0.0

    def reseed(self, seed: np.random.SeedSequence) -> None:
        """Take a new generator for noise, jitter and losses."""
        self._rng = np.random.default_rng(seed)

    def start(self) -> None:
        """Begin to stream; samples from before are dropped."""
        self._require_answer()
        now = self._clock.now()
        self._stream.start(now)
        self._last_heard_s = now
        self._streaming = True

    def stop(self) -> None:
        """End the stream."""
        self._streaming = False

    def close(self) -> None:
        """Disconnect; the stream ends."""
        self._streaming = False
        super().close()

    def read(self) -> Samples:
        """Return all samples since the last call. Raises DeviceError: not streaming, or silent for too long."""
        self._require_open()
        streaming(self.name, self._streaming)
        now = self._clock.now()
        sent_until = min(now, self._blind_from_s())
        arrivals = self._stream.arrived(sent_until, self._rng, self._faults.drop_share)
        if not len(arrivals):
            return self._nothing_heard(now)
        self._last_heard_s = sent_until
        values, saturated = self.measure(arrivals.taken_s)
        return self._samples(arrivals, values, saturated)

    def _blind_from_s(self) -> float:
        """Return when its samples end, by the clock; inf if they never do."""
        return self._silent_from_s()

    def measure(self, time_s: FloatArray) -> tuple[FloatArray, int]:
        """Return what the sensor reads at these times, shape (n, channels), and how many samples stand at its end.

        For an emulator, which has a wire of its own in place of this one's.
        """
        values = self._measure(time_s)
        if self._disturbed:
            values = self._with_faults(values)
        saturated = self._clip(values)
        return values, saturated

    @abstractmethod
    def _measure(self, time_s: FloatArray) -> FloatArray:
        """Return the values, shape (n, channels), before the end of the range is applied."""

    def _empty(self) -> Samples:
        return Samples.empty(len(self.channels))

    def _nothing_heard(self, now_s: float) -> Samples:
        silence = now_s - self._last_heard_s
        if silence > max(_SILENCE_S, _SILENT_SAMPLES / self.rate_hz):
            raise DeviceError(
                self.name,
                f"has sent nothing for {silence:.2g} s (expected {self.rate_hz:g} samples/s)",
                hint="check its power and its cable, then labrun resume",
            )
        return self._empty()

    def _with_faults(self, values: FloatArray) -> FloatArray:
        if self._faults.saturate:
            ends = np.where(np.isfinite(self._full_scale), self._full_scale, values)
            values = np.broadcast_to(ends, values.shape).copy()
        after = self._faults.nonsense_after_s
        if after is not None and self._since_open_s() >= after:
            values = self._rng.choice([np.nan, 1e6, -1e6], size=values.shape)
        return values

    def _clip(self, values: FloatArray) -> int:
        # The greatest value of all channels decides at once in nearly every case; NaN passes as it is.
        if not self._bounded or (np.abs(values).max(axis=0) < self._full_scale).all():
            return 0
        with np.errstate(invalid="ignore"):
            at_end = np.abs(values) >= self._full_scale
        np.clip(values, -self._full_scale, self._full_scale, out=values)
        return int(at_end.any(axis=1).sum())

    def _samples(self, arrivals: Arrivals, values: FloatArray, saturated: int) -> Samples:
        device_time = arrivals.device_time_s if self._has_clock else arrivals.host_time_s
        lost = arrivals.lost if self._counts_frames else 0
        return Samples(device_time, arrivals.host_time_s, values, lost=lost, saturated=saturated)
