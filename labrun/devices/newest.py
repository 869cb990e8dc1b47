"""The newest sample of a sensor, where compiled code finds it without waiting for Python."""

import contextlib
import os
from typing import NamedTuple

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.devices.samples import Samples

SLOTS = 16
"""A reader has as many samples' time to copy one before it is overwritten."""
_JUMP_S = 1.0
"""A device clock that differs by more from what it was was set or garbled: its offset is found anew."""


class SampleClock:
    """Tells when samples were made, by the run's clock: received no sooner than made, as in the stored times."""

    def __init__(self) -> None:
        self._behind_s = np.inf

    def made_s(self, device_time_s: FloatArray, host_time_s: FloatArray) -> FloatArray:
        """Return the times of a block, (n,) with n > 0."""
        least = float((host_time_s - device_time_s).min())
        if not abs(least - self._behind_s) < _JUMP_S or least < self._behind_s:
            self._behind_s = least
        return device_time_s + self._behind_s


class NewestView(NamedTuple):
    """What compiled code sees of a `Newest`: the newest sample stands in row ``(number - 1) % SLOTS``.

    Attributes
    ----------
    number : (1,)
        Samples so far.
    made_s, heard_s : (SLOTS,)
        When each was made, and when it was received, by the run's clock.
    values : (SLOTS, channels)
    """

    number: IntArray
    made_s: FloatArray
    heard_s: FloatArray
    values: FloatArray


class Bell:
    """Wakes compiled code that sleeps until a sample comes (`labrun.devices.system_calls.sleep_until_rung`); Linux.

    Attributes
    ----------
    file
        Descriptor that can be read once it was rung. It is closed when nobody holds the bell any more: a listening
        thread may be about to ring it.
    """

    def __init__(self) -> None:
        self.file = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def ring(self) -> None:
        """Wake who sleeps, or who is about to."""
        with contextlib.suppress(BlockingIOError):
            os.eventfd_write(self.file, 1)

    def __del__(self) -> None:
        with contextlib.suppress(AttributeError, OSError):
            os.close(self.file)


class Newest:
    """Keeps the newest samples of a sensor; one thread writes, any number read.

    Parameters
    ----------
    channels
        Number of values in a sample.
    bell
        Is rung with every block, if somebody sleeps until then.
    """

    def __init__(self, channels: int, bell: Bell | None = None) -> None:
        never = np.full(SLOTS, -np.inf)
        values = np.full((SLOTS, channels), np.nan)
        self.view = NewestView(np.zeros(1, dtype=np.int64), never, never.copy(), values)
        self._clock = SampleClock()
        self._bell = bell

    def put(self, samples: Samples) -> None:
        """Take a block; its last sample is the newest."""
        if not len(samples):
            return
        made_s = self._clock.made_s(samples.device_time_s, samples.host_time_s)
        number, times, heard_s, values = self.view
        count = int(number[0]) + len(samples)
        row = (count - 1) % SLOTS
        times[row], heard_s[row], values[row] = made_s[-1], samples.host_time_s[-1], samples.values[-1]
        number[0] = count  # last: who sees the number finds the sample
        if self._bell is not None:
            self._bell.ring()
