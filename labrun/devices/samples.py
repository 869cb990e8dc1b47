"""What a sensor hands over: blocks of samples that keep both of their times."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from labrun.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Channel:
    """One measured quantity of a device: its name within the device, and its SI unit."""

    name: str
    unit: str


SIX_AXES: tuple[Channel, ...] = (
    Channel("force_x", "N"), Channel("force_y", "N"), Channel("force_z", "N"),
    Channel("torque_x", "N m"), Channel("torque_y", "N m"), Channel("torque_z", "N m"),
)  # fmt: skip
"""What a six-axis force/torque sensor measures."""


@dataclass(frozen=True, slots=True)
class Samples:
    """A block of samples of one device.

    Attributes
    ----------
    device_time_s : (n,)
        Time by the device's own clock or counter, s. A device without one repeats `host_time_s`.
    host_time_s : (n,)
        Host monotonic time of receipt, s, by the run's clock.
    values : (n, channels)
        SI units, in the order of the device's `channels`.
    lost
        Samples the device made that never arrived (gaps of its counter).
    saturated
        Samples in this block at the end of the measuring range.
    """

    device_time_s: FloatArray
    host_time_s: FloatArray
    values: FloatArray
    lost: int = 0
    saturated: int = field(default=0)

    def __len__(self) -> int:
        return len(self.host_time_s)

    @classmethod
    def empty(cls, channels: int) -> "Samples":
        """Return a block without samples."""
        return cls(np.empty(0), np.empty(0), np.empty((0, channels)))

    @classmethod
    def join(cls, blocks: "Sequence[Samples]", channels: int) -> "Samples":
        """Return one block with all samples of `blocks`, in their order."""
        if not blocks:
            return cls.empty(channels)
        return cls(
            np.concatenate([block.device_time_s for block in blocks]),
            np.concatenate([block.host_time_s for block in blocks]),
            np.concatenate([block.values for block in blocks]),
            lost=sum(block.lost for block in blocks),
            saturated=sum(block.saturated for block in blocks),
        )
