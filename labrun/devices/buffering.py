"""Between the thread that hears a sensor and the runner that asks for its samples."""

import threading

import numpy as np
from numpy.typing import ArrayLike

from labrun.arrays import FloatArray
from labrun.devices.samples import Samples


class SampleBuffer:
    """Collects samples until someone takes them; any number of threads.

    Parameters
    ----------
    channels
        Number of values in a sample.
    """

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._lock = threading.Lock()
        self._blocks: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        self._lost = 0
        self._saturated = 0

    def put(
        self,
        device_time_s: ArrayLike,
        host_time_s: ArrayLike,
        values: ArrayLike,
        *,
        lost: int = 0,
        saturated: int = 0,
    ) -> None:
        """Add one sample (two numbers and a row) or a block (two vectors and a matrix of rows).

        Parameters
        ----------
        device_time_s, host_time_s : () or (n,)
            As of `Samples`.
        values : (channels,) or (n, channels)
            SI units.
        lost, saturated
            Samples that never arrived before these, and samples of these at the end of the range.

        Raises
        ------
        ValueError
            Shapes that do not belong together.
        """
        rows = np.array(values, dtype=float, ndmin=2)
        device_s = np.array(device_time_s, dtype=float, ndmin=1)
        host_s = np.array(host_time_s, dtype=float, ndmin=1)
        if rows.shape != (len(host_s), self._channels) or len(device_s) != len(host_s):
            raise ValueError(
                f"{len(device_s)} device times, {len(host_s)} host times and values of shape {rows.shape} "
                f"do not make samples of {self._channels} channels"
            )
        with self._lock:
            self._blocks.append((device_s, host_s, rows))
            self._lost += lost
            self._saturated += saturated

    def count_lost(self, lost: int) -> None:
        """Add to the samples that never arrived."""
        with self._lock:
            self._lost += lost

    def take(self) -> Samples:
        """Return all samples since the last time, as one block; does not wait."""
        with self._lock:
            blocks, self._blocks = self._blocks, []
            lost, self._lost = self._lost, 0
            saturated, self._saturated = self._saturated, 0
        if not blocks:
            nothing = np.empty(0)
            return Samples(nothing, nothing, np.empty((0, self._channels)), lost=lost, saturated=saturated)
        device_s, host_s, rows = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        return Samples(device_s, host_s, rows, lost=lost, saturated=saturated)

    def clear(self) -> None:
        """Forget everything."""
        self.take()
