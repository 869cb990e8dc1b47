"""The newest sample of a sensor, where compiled code finds it without waiting for Python."""

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
    """What compiled code sees of a `Newest`: sample number n stands in row ``n % SLOTS`` once `number` is above n.

    Attributes
    ----------
    number : (1,)
        Samples so far.
    made_s : (SLOTS,)
        When each was made, by the run's clock.
    values : (SLOTS, channels)
    """

    number: IntArray
    made_s: FloatArray
    values: FloatArray


class Newest:
    """Keeps the newest samples of a sensor; one thread writes, any number read.

    Parameters
    ----------
    channels
        Number of values in a sample.
    """

    def __init__(self, channels: int) -> None:
        self.view = NewestView(
            np.zeros(1, dtype=np.int64), np.full(SLOTS, -np.inf), np.full((SLOTS, channels), np.nan)
        )
        self._clock = SampleClock()

    def put(self, samples: Samples) -> None:
        """Take a block; its last sample is the newest."""
        if not len(samples):
            return
        made_s = self._clock.made_s(samples.device_time_s, samples.host_time_s)
        number, times, values = self.view
        row = int(number[0]) % SLOTS
        times[row], values[row] = made_s[-1], samples.values[-1]
        number[0] += 1  # last: who sees the number finds the sample
