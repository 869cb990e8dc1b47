"""What gives six voltages: the only part of the driver that knows which card it is."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from labrun.devices import FloatArray
from labrun_plugins.ati_daq.settings import GAUGES


@dataclass(frozen=True, slots=True)
class Voltages:
    """A block of samples.

    Attributes
    ----------
    first
        Number of its first sample since the start, by the card's own count: a gap is a loss.
    values : (n, 6)
        V.
    """

    first: int
    values: FloatArray = field(default_factory=lambda: np.empty((0, GAUGES)))


@dataclass(frozen=True, slots=True)
class Card:
    """What the voltages come from."""

    model: str
    serial: str = ""
    firmware: str = ""


class VoltageReader(Protocol):
    """Reads six voltages at a steady rate. All of its errors are DeviceErrors that name the device."""

    def open(self) -> Card:
        """Connect, and say to what."""
        ...

    def start(self, rate_hz: float) -> float:
        """Begin to sample; return the true rate, Hz."""
        ...

    def read(self) -> Voltages:
        """Return what has been sampled since the last time, waiting a few hundredths of a second for it at most."""
        ...

    def stop(self) -> None:
        """End sampling; harmless if it does not."""
        ...

    def close(self) -> None:
        """Disconnect; harmless when not connected. Never raises."""
        ...
