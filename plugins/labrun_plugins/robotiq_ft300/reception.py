"""What comes from the sensor while it measures: samples, and the watch over whether they still come."""

import math

from labrun.devices import Clock, DeviceError, SampleBuffer, SerialPort
from labrun_plugins.robotiq_ft300 import codec
from labrun_plugins.robotiq_ft300.link import Registers

_STRETCH = 25
"""Frames a stretch: losses are told by the end of the next stretch."""


class GapCounter:
    """Estimates lost frames from receive times.

    Frames leave the sensor on a regular grid and come some time after it. The least late frame of each stretch of
    25 frames says where the grid stands: if even that one is late by n periods, n frames are missing. A host that
    was busy for a while is not mistaken for a loss, since the frames it then finds all at once end on the grid again;
    nor is a sensor whose clock is off by up to half a period a stretch (2 %).

    Parameters
    ----------
    period_s
        Of the grid.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
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
        return self.settle() if self._heard >= _STRETCH else 0

    def settle(self) -> int:
        """Judge by the frames since the last time, though they may be few; return the losses found."""
        if self._next_s is None or self._heard < 3:
            return 0
        lost = round(self._least_late_s / self._period_s)
        self._next_s += self._least_late_s
        self._heard = 0
        self._least_late_s = math.inf
        return lost


_GRACE_S = 0.5
"""How long the first frame may take after the start."""
_POLL_PATIENCE_S = 0.5
_NAP_S = 0.005
_LOOKS = 3
_BITS_PER_BYTE = 10


class Reception:
    """Takes frames of the stream off the port. `receive` is for a thread of its own.

    Parameters
    ----------
    baud
        How fast bytes follow one another on the line: frames that are read at once ended that long before.
    silence_s
        Without a good frame for this long, the stream is lost.

    Attributes
    ----------
    parser
        Counts what came.
    first_s, last_s
        When the first and the latest frame came.
    lumps
        Portions in which frames were handed over.
    lost
        Frames lost, by estimate.
    ended
        Set it when the stream has been told to end: what still comes is thrown away, and silence is no fault.
    """

    def __init__(
        self,
        device: str,
        port: SerialPort,
        clock: Clock,
        buffer: SampleBuffer,
        *,
        baud: int,
        silence_s: float,
    ) -> None:
        self._device = device
        self._port = port
        self._clock = clock
        self._buffer = buffer
        self._byte_s = _BITS_PER_BYTE / baud
        self._silence_s = silence_s
        self.parser = codec.StreamParser()
        self._gaps = GapCounter(1.0 / codec.STREAM_HZ)
        self._good_s = clock.now() + _GRACE_S
        self._bad_bytes = 0
        self._empty = 0
        self.first_s: float | None = None
        self.last_s = 0.0
        self.lumps = 0
        self.lost = 0
        self.ended = False

    def receive(self) -> None:
        """Take what has arrived, waiting briefly for it.

        Raises DeviceError: unplugged; or no good frame for too long.
        """
        data = self._port.read()
        if self.ended:
            return
        now_s = self._clock.now()
        frames = self.parser.feed(data)
        self._empty = 0 if data else self._empty + 1
        if frames:
            self._good_s = max(now_s, self._good_s)
            self._bad_bytes = 0
            self._put(frames, now_s)
        else:
            self._bad_bytes += len(data)
            self._check(now_s)

    def settle(self) -> None:
        """Count what is missing at the end of the stream."""
        self._count(self._gaps.settle())

    def rate_hz(self) -> float:
        """Return the frames per second received so far; 0 before the second one."""
        if self.first_s is None or self.last_s <= self.first_s:
            return 0.0
        return (self.parser.frames - 1) / (self.last_s - self.first_s)

    def _put(self, frames: list[codec.Frame], now_s: float) -> None:
        times = []
        for frame in frames:
            time_s = max(now_s - frame.later_bytes * self._byte_s, self.last_s)
            self.first_s = time_s if self.first_s is None else self.first_s
            self.last_s = time_s
            times.append(time_s)
            self._count(self._gaps.hear(time_s))
        self.lumps += 1
        counts = [frame.counts for frame in frames]
        self._buffer.put(times, times, codec.wrench(counts), saturated=codec.saturated(counts))

    def _count(self, lost: int) -> None:
        self.lost += lost
        self._buffer.count_lost(lost)

    def _check(self, now_s: float) -> None:
        quiet_s = now_s - self._good_s
        # If this thread could not run for a while, its looks tell more than the time: frames may be on their way.
        if quiet_s <= self._silence_s or (0 < self._empty < _LOOKS):
            return
        if self._bad_bytes >= codec.FRAME_BYTES:
            raise DeviceError(
                self._device,
                f"no frame of its stream is right: {self._bad_bytes} bytes in {quiet_s:.2g} s, all checksums wrong",
                hint="check the ground and the shield of its RS-485 cable, and that nothing else talks on the line",
            )
        raise DeviceError(
            self._device,
            f"its stream stopped: nothing for {quiet_s:.2g} s ({codec.STREAM_HZ:g} frames/s expected)",
            hint="check its 24 V supply and its cable; labrun resume starts the stream again",
        )


class Polling:
    """Reads the wrench register by register request, again and again; the same part as `Reception`."""

    def __init__(self, registers: Registers, clock: Clock, buffer: SampleBuffer, rate_hz: float) -> None:
        self._registers = registers
        self._clock = clock
        self._buffer = buffer
        self._period_s = 1.0 / rate_hz
        self._due_s = clock.now()
        self._good_s = clock.now()
        self.readings = 0
        self.lost = 0

    def receive(self) -> None:
        """Wait for the next reading's time, a little at a time, and take it.

        Raises DeviceError: it has not answered for half a second.
        """
        left_s = self._due_s - self._clock.now()
        if left_s > 0.0:
            self._clock.sleep(min(left_s, _NAP_S))
            return
        self._due_s += self._period_s
        try:
            counts = codec.signed(self._registers.read(codec.WRENCH, 6))
        except DeviceError:
            self._count(1)
            if self._clock.now() - self._good_s > _POLL_PATIENCE_S:
                raise
            return
        now_s = self._good_s = self._clock.now()
        self.readings += 1
        self._buffer.put(now_s, now_s, codec.wrench([counts]), saturated=codec.saturated([counts]))
        behind = int((now_s - self._due_s) / self._period_s)
        if behind > 0:
            self._due_s += behind * self._period_s
            self._count(behind)

    def settle(self) -> None:
        """Do nothing: every missing reading is counted at once."""

    def _count(self, lost: int) -> None:
        self.lost += lost
        self._buffer.count_lost(lost)
