"""The latest samples of the channels that loops use, tared, on one clock."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from labrun.devices import FloatArray, Samples
from labrun.devices.listening import SampleClock
from labrun.signals import Signals

_CAPACITY = 4096


class _Track:
    """The needed channels of one device, by their columns in its samples."""

    def __init__(
        self, device: str, columns: Mapping[str, int], tare: Mapping[str, float], keep_s: float
    ) -> None:
        self._columns = list(columns.values())
        self._measured = Signals(
            device,
            tuple(columns),
            ("",) * len(columns),
            np.empty(0),
            np.empty((0, len(columns))),
            {name: tare[name] for name in columns if name in tare},
        )
        self._keep_s = keep_s
        self._time_s = np.empty(_CAPACITY)
        self._values = np.empty((len(self._columns), _CAPACITY))
        self._first = 0
        self._end = 0
        self._clock = SampleClock()
        self.last_s = -np.inf
        self.heard_s = -np.inf

    def take(self, block: Samples, start_s: float) -> None:
        count = len(block)
        time_s = self._clock.made_s(block.device_time_s, block.host_time_s) - start_s
        if self._end + count > len(self._time_s):
            self._make_room(count)
        here = slice(self._end, self._end + count)
        np.maximum(np.maximum.accumulate(time_s), self.last_s, out=self._time_s[here])
        measured = replace(self._measured, values=block.values[:, self._columns])
        self._values[:, here] = measured.tared().values.T
        before_s, self._end = self.last_s, self._end + count
        self.last_s = float(self._time_s[self._end - 1])
        self.heard_s = float(block.host_time_s[-1])
        # what was measured before the recording began was the bench at rest
        if before_s < 0.0 <= self.last_s:
            self._first = int(np.searchsorted(self._time_s[: self._end], 0.0))

    def recent(self, row: int) -> tuple[FloatArray, FloatArray]:
        return self._time_s[self._first : self._end], self._values[row, self._first : self._end]

    def newest(self, row: int) -> tuple[float, float]:
        return self.last_s, float(self._values[row, self._end - 1])

    def _make_room(self, count: int) -> None:
        """Drop old samples, or grow if all are needed."""
        oldest = int(np.searchsorted(self._time_s[: self._end], self.last_s - self._keep_s)) - 1
        first = min(max(self._first, oldest), self._end)
        kept = self._end - first
        capacity = len(self._time_s)
        while 2 * kept + count > capacity:
            capacity *= 2
        time_s, values = np.empty(capacity), np.empty((len(self._columns), capacity))
        time_s[:kept] = self._time_s[first : self._end]
        values[:, :kept] = self._values[:, first : self._end]
        self._time_s, self._values, self._first, self._end = time_s, values, 0, kept


class History:
    """What has been measured lately in a trial.

    Times are those at which samples were made, by the run's clock, from the start of the recording. Samples from before
    it count only until the first one of the recording is there.

    Parameters
    ----------
    channels
        ``device.channel`` -> column of that device's samples.
    tare
        Offsets by channel, subtracted as in objectives.
    start_s
        The clock's time at which the recording begins.
    keep_s
        How far back anyone looks.
    """

    def __init__(
        self, channels: Mapping[str, int], tare: Mapping[str, float], start_s: float, keep_s: float
    ) -> None:
        self._start_s = start_s
        by_device: dict[str, list[str]] = {}
        for channel in channels:
            by_device.setdefault(channel.partition(".")[0], []).append(channel)
        self._tracks = {
            device: _Track(device, {name: channels[name] for name in names}, tare, keep_s)
            for device, names in by_device.items()
        }
        self._places = {
            name: (self._tracks[device], row)
            for device, names in by_device.items()
            for row, name in enumerate(names)
        }

    def take(self, blocks: Mapping[str, Samples]) -> None:
        """Append new samples of each device."""
        for device, track in self._tracks.items():
            block = blocks.get(device)
            if block is not None and len(block):
                track.take(block, self._start_s)

    @property
    def complete(self) -> bool:
        """Tell whether every channel has a sample."""
        return all(np.isfinite(track.last_s) for track in self._tracks.values())

    def newest_s(self, channels: Sequence[str]) -> float:
        """Return when the newest sample was made that all of these channels had to wait for."""
        return min(self._places[channel][0].last_s for channel in channels)

    def heard_s(self, channels: Sequence[str]) -> float:
        """Return when the newest sample of any of these channels was received, by the run's clock."""
        return max(self._places[channel][0].heard_s for channel in channels)

    def newest(self, channel: str) -> tuple[float, float]:
        """Return when the newest sample of a channel was made, and its value."""
        track, row = self._places[channel]
        return track.newest(row)

    def recent(self, channel: str) -> tuple[FloatArray, FloatArray]:
        """Return times and values of a channel, oldest first, both of shape (n,); at least what is kept."""
        track, row = self._places[channel]
        return track.recent(row)
