"""A trial too long for memory: its samples grow in the temporary file while it runs."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from h5py import h5d, h5f

from labrun.devices.samples import Channel, FloatArray, Samples
from labrun.store import hdf5, layout
from labrun.store.attributes import Attribute, write_attribute, write_attributes
from labrun.store.blocks import BLOCK, blocks
from labrun.store.timing import ClockMap

_METADATA = 1 << 20
"""Bytes that are more than enough for what HDF5 writes beside the samples of one block."""


@dataclass(frozen=True)
class SpilledStream:
    """A stream whose samples are on disk: as `labrun.store.trial.Stream`, but only what is asked for is in memory.

    A column is read anew each time; the times, which every column needs, are kept.
    """

    name: str
    channels: tuple[Channel, ...]
    rate_hz: float
    lost: int
    saturated: int
    _file: "SpillFile"
    _start_s: float

    @cached_property
    def time_s(self) -> FloatArray:
        """Trial-relative times, shape (n,), as they will be stored."""
        return self._file.time_s(self.name, self._start_s)

    @property
    def device_time_s(self) -> FloatArray:
        """The device's own times, shape (n,)."""
        return self._file.column(self.name, "device_time_s")

    @property
    def host_time_s(self) -> FloatArray:
        """Times of arrival, shape (n,)."""
        return self._file.column(self.name, "host_time_s")

    @property
    def values(self) -> FloatArray:
        """All channels, shape (n, channels): as large as the trial."""
        return np.column_stack([self.column(channel.name) for channel in self.channels])

    def column(self, channel: str) -> FloatArray:
        """Return the values of one channel, shape (n,); KeyError if there is none of that name."""
        self._check(channel)
        return self._file.column(self.name, channel)

    def pieces(self, channel: str) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield times and values of one channel, `BLOCK` of them at a time; KeyError if there is none of that name."""
        self._check(channel)
        return zip(
            self._file.time_blocks(self.name, self._start_s),
            self._file.column_blocks(self.name, channel),
            strict=True,
        )

    def _check(self, channel: str) -> None:
        if all(known.name != channel for known in self.channels):
            raise KeyError(channel)


class SpillFile:
    """The temporary file of a long trial.

    Parameters
    ----------
    path
        Made anew; nothing of it counts before it is renamed.
    """

    def __init__(self, path: Path) -> None:
        self.file: h5f.FileID = hdf5.create_on_disk(str(path))
        self._groups: dict[str, Any] = {}
        self._clocks: dict[str, ClockMap] = {}

    def add(self, device: str, channels: Sequence[Channel], rate_hz: float, samples: Samples) -> None:
        """Append samples of one device; the clock learns from them on the way."""
        datasets = len(layout.TIMES) + len(channels)
        hdf5.reserve(self.file, datasets * (8 * (len(samples) + BLOCK)) + _METADATA)
        if device not in self._groups:
            self._make_group(device, channels)
            self._clocks[device] = ClockMap(rate_hz)
        self._clocks[device].learn(samples.device_time_s, samples.host_time_s)
        self._extend(device, "device_time_s", samples.device_time_s)
        self._extend(device, "host_time_s", samples.host_time_s)
        for number, channel in enumerate(channels):
            self._extend(device, channel.name, samples.values[:, number])

    def stream(
        self,
        device: str,
        channels: tuple[Channel, ...],
        rate_hz: float,
        lost: int,
        saturated: int,
        start_s: float,
    ) -> "SpilledStream":
        """Return what a device delivered so far, to be read column by column while this file is open."""
        return SpilledStream(device, channels, rate_hz, lost, saturated, self, start_s)

    def column(self, device: str, name: str) -> FloatArray:
        """Return one column whole."""
        return self._whole(device, self.column_blocks(device, name))

    def column_blocks(self, device: str, name: str) -> Iterator[FloatArray]:
        """Yield one column, `BLOCK` values at a time."""
        return blocks(self._dataset(device, name))

    def time_s(self, device: str, start_s: float) -> FloatArray:
        """Return the trial-relative times that `complete` will store."""
        return self._whole(device, self.time_blocks(device, start_s))

    def time_blocks(self, device: str, start_s: float) -> Iterator[FloatArray]:
        """Yield the trial-relative times that `complete` will store, `BLOCK` of them at a time."""
        return map(self._clocks[device].mapper(start_s), self.column_blocks(device, "device_time_s"))

    def complete(
        self, device: str, start_s: float, tare: dict[str, float], attributes: dict[str, Attribute]
    ) -> None:
        """Add trial-relative times, tare offsets and attributes to a device's group, block by block."""
        group = self._groups[device]
        (length,) = self._dataset(device, "device_time_s").shape
        hdf5.reserve(self.file, 8 * (length + BLOCK) + _METADATA)
        clock = self._clocks[device]
        mapper = clock.mapper(start_s)
        for device_time_s in blocks(self._dataset(device, "device_time_s")):
            self._extend(device, "time_s", mapper(device_time_s))
        for channel, offset in tare.items():
            write_attribute(self._dataset(device, channel), "tare", float(offset))
        write_attributes(group, attributes | {"clock_glitches": clock.glitches})

    def close(self) -> None:
        """Write everything out and close."""
        hdf5.close(self.file)

    def abandon(self) -> None:
        """Close without caring whether the disk takes what is left."""
        with suppress(Exception):
            self.file.close()

    def _make_group(self, device: str, channels: Sequence[Channel]) -> None:
        group = self._groups[device] = hdf5.create_group(self.file, device)
        units = dict.fromkeys(layout.TIMES, "s") | {channel.name: channel.unit for channel in channels}
        scale = None
        for name, unit in units.items():
            dataset = hdf5.create_growing(group, name)
            write_attribute(dataset, "units", unit)
            scale = hdf5.join_axis(dataset, name, scale)

    def _whole(self, device: str, parts: Iterator[FloatArray]) -> FloatArray:
        values = np.empty(self._dataset(device, "device_time_s").shape)
        end = 0
        for part in parts:
            values[end : end + len(part)] = part
            end += len(part)
        return values

    def _dataset(self, device: str, name: str) -> h5d.DatasetID:
        return h5d.open(self._groups[device], name.encode())

    def _extend(self, device: str, name: str, values: Any) -> None:
        hdf5.extend(self._dataset(device, name), values)
