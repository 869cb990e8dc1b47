"""One trial on its way to disk: in memory while it is small, in temporary files when it grows."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.devices import Channel, Samples, Trajectory
from labrun.signals import MEMORY_ROWS, LongSignals, Signals
from labrun.store.disk import fsync_directory, fsync_file, saving, write_all
from labrun.store.timing import ClockMap
from labrun.store.trial import TrialOutcome
from labrun.store.trial_file import COMMAND, check_names, digest_of, write_trial

SPILL_BYTES = 8 << 20
"""Samples in memory, all devices together, above which they go to temporary files."""


class _Device:
    """What one device has delivered: blocks in memory, and before them rows in a temporary file of a long trial."""

    def __init__(self, name: str, channels: tuple[Channel, ...], rate_hz: float, spill: Path) -> None:
        self.spill = spill
        self._head = undated(name, channels, rate_hz)
        self.lost = 0
        self.saturated = 0
        self._blocks: list[Samples] = []
        self._mapped: tuple[float, Signals] | None = None
        self._clock = ClockMap(rate_hz)
        self._file: int | None = None
        self._spilled = 0

    def append(self, samples: Samples) -> None:
        self._blocks.append(samples)
        self._mapped = None

    def signals(self, start_s: float, tare: Mapping[str, float]) -> Signals | LongSignals:
        """Return everything, its time from `start_s` on."""
        about: dict[str, Any] = {"lost": self.lost, "saturated": self.saturated, "tare": tare}
        if self._file is None:
            if self._mapped is None or self._mapped[0] != start_s:
                self._mapped = start_s, dated(self._head, self._joined(), start_s)
            return replace(self._mapped[1], **about)
        self.move_to_disk()
        head = replace(self._head, clock_glitches=self._clock.glitches, **about)
        return LongSignals(head, self._spilled, lambda first: self._read(head, start_s, first))

    def _joined(self) -> Samples:
        if len(self._blocks) != 1:
            self._blocks = [Samples.join(self._blocks, len(self._head.columns))]
        return self._blocks[0]

    def move_to_disk(self) -> None:
        """Append what is in memory to the temporary file; the clock learns from it on the way."""
        samples = self._joined()
        self._clock.learn(samples.device_time_s, samples.host_time_s)
        if self._file is None:
            self._file = os.open(self.spill, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)
        rows = np.column_stack([samples.device_time_s, samples.host_time_s, samples.values])
        write_all(self._file, rows.tobytes())
        self._spilled += len(rows)
        self._blocks = []

    def _read(self, head: Signals, start_s: float, wanted: int) -> Iterator[Signals]:
        """Yield pieces from sample `wanted` on; times follow from those before it."""
        mapper = self._clock.mapper(start_s)
        width = 2 + len(head.columns)
        with self.spill.open("rb") as file:
            for first in range(0, max(self._spilled, 1), MEMORY_ROWS):
                count = min(MEMORY_ROWS, self._spilled - first)
                rows: FloatArray = np.fromfile(file, float, count * width).reshape(-1, width)
                piece = replace(
                    head,
                    time_s=mapper(rows[:, 0]),
                    values=rows[:, 2:],
                    device_time_s=rows[:, 0],
                    host_time_s=rows[:, 1],
                )
                if first + count > wanted or wanted == 0:
                    yield piece[max(wanted - first, 0) :]

    def forget(self) -> None:
        """Let go of everything, and remove the temporary file. Never raises."""
        self._blocks, self._mapped = [], None
        if self._file is not None:
            with suppress(OSError):
                os.close(self._file)
            with suppress(OSError):
                self.spill.unlink(missing_ok=True)
            self._file = None


def undated(name: str, channels: Sequence[Channel], rate_hz: float) -> Signals:
    """Return the signals of a device without a sample yet."""
    return Signals(
        name,
        tuple(channel.name for channel in channels),
        tuple(channel.unit for channel in channels),
        np.empty(0),
        np.empty((0, len(channels))),
        device_time_s=np.empty(0),
        host_time_s=np.empty(0),
        rate_hz=rate_hz,
    )


def dated(head: Signals, samples: Samples, start_s: float) -> Signals:
    """Return a device's samples as signals, on the run's clock from `start_s` on."""
    clock = ClockMap(head.rate_hz)
    clock.learn(samples.device_time_s, samples.host_time_s)
    return replace(
        head,
        time_s=clock.mapper(start_s)(samples.device_time_s),
        values=samples.values,
        device_time_s=samples.device_time_s,
        host_time_s=samples.host_time_s,
        clock_glitches=clock.glitches,
    )


def tare_of(device: str, tare: Mapping[str, float]) -> dict[str, float]:
    """Return the offsets of one device by channel, of those by ``device.channel``."""
    return {
        key.removeprefix(f"{device}."): offset for key, offset in tare.items() if key.startswith(f"{device}.")
    }


class TrialWriter:
    """Collects the samples of one trial and puts its file in place whole.

    Made by `RunFolder.writer`. Until `finish` returns, nothing of the trial has its final name; a crash leaves
    at most temporary files, which the folder removes when it is opened again.

    Parameters
    ----------
    trials
        The folder of trial files.
    sync
        Wait until the trial is on disk. A dry run need not survive a power cut.
    stored
        Called once the trial has its name: with the outcome, and the file's size and digest.
    saved
        Tells what is saved so far, for an error message.
    """

    def __init__(
        self,
        trials: Path,
        index: int,
        *,
        sync: bool,
        stored: Callable[[TrialOutcome, Mapping[str, Any]], None],
        saved: Callable[[], str],
    ) -> None:
        self.index = index
        self.path = trials / f"{index:06d}.h5"
        self._partial = trials / f".{index:06d}.h5.partial"
        self._sync = sync
        self._stored = stored
        self._saved = saved
        self._devices: dict[str, _Device] = {}
        self._bytes = 0
        self._spilled = False

    def append(self, device: str, channels: tuple[Channel, ...], rate_hz: float, samples: Samples) -> None:
        """Take a block of samples of one device.

        Raises
        ------
        StoreError
            The device or a channel has a name that cannot be stored, or the disk is full.
        """
        known = self._devices.get(device)
        if known is None:
            check_names(device, [channel.name for channel in channels])
            spill = self._partial.with_name(f".{self.index:06d}.{len(self._devices)}.partial")
            known = self._devices[device] = _Device(device, channels, rate_hz, spill)
        known.lost += samples.lost
        known.saturated += samples.saturated
        if len(samples):
            known.append(samples)
            self._bytes += 8 * len(samples) * (2 + len(channels))
            if self._bytes > SPILL_BYTES:
                with self._saving():
                    self._move_to_disk()

    @property
    def bytes_in_memory(self) -> int:
        """Size of the samples that are not on disk yet."""
        return self._bytes

    def signals(self, start_s: float, tare: Mapping[str, float]) -> dict[str, Signals | LongSignals]:
        """Return what was recorded so far, by device.

        Of a trial too long for memory, the samples are read from temporary files when they are asked for, which must
        be before `finish`.

        Parameters
        ----------
        start_s
            The run clock's time that becomes `time_s` = 0.
        tare
            Offsets by ``"device.channel"``.
        """
        if self._spilled:
            with self._saving():
                self._move_to_disk()
        return {name: device.signals(start_s, tare_of(name, tare)) for name, device in self._devices.items()}

    def finish(self, outcome: TrialOutcome, settle_curve: Signals | None, command: Trajectory | None) -> None:
        """Store the trial: when this returns, it survives the end of the process and, if synced, a power cut.

        Raises
        ------
        StoreError
            The disk is full or fails. This trial is gone, everything before it is untouched.
        """
        tables: list[Signals | LongSignals] = [*self.signals(outcome.started_s, outcome.tare).values()]
        if command is not None:
            tables.append(command_signals(command))
        if settle_curve is not None:
            tables.append(settle_curve)
        with self._saving():
            write_trial(self._partial, outcome, tables)
            if self._sync:
                fsync_file(self._partial)
            described: dict[str, Any] = {"bytes": self._partial.stat().st_size}
            if not self._spilled:
                described["blake2b"] = digest_of(self._partial.read_bytes())
            self._partial.rename(self.path)
            if self._sync:
                fsync_directory(self.path.parent)
        self._forget()
        self._stored(outcome, described)

    def discard(self) -> None:
        """Forget the trial and remove its temporary files. Never raises."""
        self._forget()
        with suppress(OSError):
            self._partial.unlink(missing_ok=True)

    def _forget(self) -> None:
        for device in self._devices.values():
            device.forget()
        self._devices = {}
        self._bytes = 0

    @contextmanager
    def _saving(self) -> Iterator[None]:
        """Explain what the disk refuses, and leave nothing half-written behind."""
        try:
            with saving(f"trial {self.index}", self.path.parent.parent, self._saved()):
                yield
        except BaseException:
            self.discard()
            raise

    def _move_to_disk(self) -> None:
        self._spilled = True
        for device in self._devices.values():
            device.move_to_disk()
        self._bytes = 0


def command_signals(command: Trajectory) -> Signals:
    """Return commanded joint angles as they are stored."""
    return Signals(
        COMMAND, tuple(command.joints), ("rad",) * len(command.joints), command.time_s, command.angle_rad
    )
