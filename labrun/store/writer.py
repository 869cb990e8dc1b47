"""One trial on its way to disk: in memory while it is small, in its temporary file when it grows."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labrun.devices.samples import Channel, Samples
from labrun.devices.trajectory import Trajectory
from labrun.store import layout
from labrun.store.disk import fsync_directory, fsync_file, saving, write_synced, write_unsynced
from labrun.store.timing import ClockMap
from labrun.store.trial import SettleCurve, Stream, TrialOutcome
from labrun.store.trial_log import TrialLog
from labrun.store.written import digest_of

if TYPE_CHECKING:
    from labrun.store.spill import SpilledStream, SpillFile
    from labrun.store.trial_image import Places, Templates

SPILL_BYTES = 8 << 20
"""Samples in memory, all devices together, above which they go to the temporary file."""


@dataclass(slots=True)
class _Device:
    """What one device has delivered and is still in memory."""

    name: str
    channels: tuple[Channel, ...]
    rate_hz: float
    lost: int = 0
    saturated: int = 0
    blocks: list[Samples] = field(default_factory=list)
    mapped: tuple[Stream, int] | None = None
    """The stream as it was last made, with the clock's glitches; None once more samples have come."""
    mapped_from_s: float = 0.0

    def joined(self) -> Samples:
        """Return what is in memory as one block, and keep it as one."""
        if len(self.blocks) != 1:
            self.blocks = [Samples.join(self.blocks, len(self.channels))]
        return self.blocks[0]


class TrialWriter:
    """Collects the samples of one trial and puts its file in place whole.

    Made by `RunFolder.writer`. Until `finish` returns, nothing of the trial has its final name; a crash leaves
    at most ``.<index>.h5.partial``, which the folder removes when it is opened again.

    Parameters
    ----------
    trials
        The folder of trial files.
    index
        The trial's execution counter.
    templates
        Of the run's earlier trials.
    log
        Makes a small trial durable before its file is.
    stored
        Called once the trial is on disk: with the outcome, the file's size and digest, where everything stands in
        it, if that is known, and whether the log has it.
    saved
        Tells what is saved so far, for an error message.
    """

    def __init__(
        self,
        trials: Path,
        index: int,
        templates: "Templates",
        log: TrialLog,
        stored: Callable[[TrialOutcome, Mapping[str, Any], "Places | None", bool], None],
        saved: Callable[[], str],
    ) -> None:
        self.index = index
        self.path = trials / f"{index:06d}.h5"
        self._partial = trials / f".{index:06d}.h5.partial"
        self._templates = templates
        self._log = log
        self._logged = False
        self._places: Places | None = None
        self._stored = stored
        self._saved = saved
        self._devices: dict[str, _Device] = {}
        self._bytes = 0
        self._spill: SpillFile | None = None

    def append(self, device: str, channels: tuple[Channel, ...], rate_hz: float, samples: Samples) -> None:
        """Take a block of samples of one device.

        Raises
        ------
        StoreError
            The device or a channel has a name that cannot be stored, or the disk is full.
        """
        known = self._devices.get(device)
        if known is None:
            layout.check_names(device, channels)
            known = self._devices[device] = _Device(device, channels, rate_hz)
        known.lost += samples.lost
        known.saturated += samples.saturated
        if len(samples):
            known.blocks.append(samples)
            known.mapped = None
            self._bytes += 8 * len(samples) * (2 + len(channels))
            if self._bytes > SPILL_BYTES:
                with self._saving():
                    self._move_to_disk()

    @property
    def bytes_in_memory(self) -> int:
        """Size of the samples that are not on disk yet."""
        return self._bytes

    def streams(self, start_s: float) -> "Mapping[str, Stream | SpilledStream]":
        """Return what was recorded so far, by device; without tare offsets.

        Of a trial too long for memory, each column is read from the temporary file when it is asked for, which must be
        before `finish`.

        Parameters
        ----------
        start_s
            The run clock's time that becomes `time_s` = 0.
        """
        if self._spill is None:
            return {device.name: self._stream(device, start_s, {})[0] for device in self._devices.values()}
        with self._saving():
            self._move_to_disk()
        return {
            device.name: self._spill.stream(
                device.name, device.channels, device.rate_hz, device.lost, device.saturated, start_s
            )
            for device in self._devices.values()
        }

    def finish(
        self, outcome: TrialOutcome, settle_curve: SettleCurve | None, command: Trajectory | None
    ) -> None:
        """Store the trial durably: when this returns, it survives a power cut.

        Raises
        ------
        StoreError
            The disk is full or fails. This trial is gone, everything before it is untouched.
        """
        with self._saving():
            complete = self._finish_in_memory if self._spill is None else self._finish_spilled
            described = complete(outcome, settle_curve, command)
            if not self._logged:
                self._put_in_place()
        self._devices = {}
        self._stored(outcome, described, self._places, self._logged)

    def discard(self) -> None:
        """Forget the trial and remove its temporary file. Never raises."""
        if self._spill is not None:
            self._spill.abandon()
            self._spill = None
        self._devices = {}
        self._bytes = 0
        with suppress(OSError):
            self._partial.unlink(missing_ok=True)

    @contextmanager
    def _saving(self) -> Iterator[None]:
        """Explain what the disk refuses, and leave nothing half-written behind."""
        try:
            with saving(f"trial {self.index}", self.path.parent.parent, self._saved()):
                from labrun.store.hdf5 import flush_errors

                with flush_errors():
                    yield
        except BaseException:
            self.discard()
            raise

    def _stream(self, device: _Device, start_s: float, tare: Mapping[str, float]) -> tuple[Stream, int]:
        if device.mapped is None or device.mapped_from_s != start_s:
            device.mapped, device.mapped_from_s = self._map(device, start_s), start_s
        stream, glitches = device.mapped
        return replace(stream, lost=device.lost, saturated=device.saturated, tare=tare), glitches

    def _map(self, device: _Device, start_s: float) -> tuple[Stream, int]:
        samples = device.joined()
        clock = ClockMap(device.rate_hz)
        clock.learn(samples.device_time_s, samples.host_time_s)
        time_s = clock.mapper(start_s)(samples.device_time_s)
        stream = Stream(
            name=device.name,
            channels=device.channels,
            time_s=time_s,
            device_time_s=samples.device_time_s,
            host_time_s=samples.host_time_s,
            values=samples.values,
            rate_hz=device.rate_hz,
        )
        return stream, clock.glitches

    def _finish_in_memory(
        self, outcome: TrialOutcome, settle_curve: SettleCurve | None, command: Trajectory | None
    ) -> dict[str, Any]:
        from labrun.store.trial_image import Content

        streams = (
            self._stream(device, outcome.started_s, layout.device_tare(outcome, device.name))
            for device in self._devices.values()
        )
        tables = [layout.stream_table(stream, glitches) for stream, glitches in streams]
        tables += layout.rest_tables(settle_curve, command)
        content, self._places = self._templates.image(
            Content(layout.outcome_attributes(outcome), tuple(tables))
        )
        digest = digest_of(content)
        if self._log.takes(len(content)):
            self._write_logged(content, digest)
        else:
            write_synced(self._partial, content)
        return {"bytes": len(content), "blake2b": digest}

    def _write_logged(self, content: bytes, digest: str) -> None:
        self._log.append(self.index, digest, content)
        try:
            write_unsynced(self._partial, content)
            self._partial.rename(self.path)
        except OSError:
            self._log.take_back()
            raise
        self._logged = True

    def _put_in_place(self) -> None:
        self._partial.rename(self.path)
        fsync_directory(self.path.parent)

    def _move_to_disk(self) -> None:
        from labrun.store.spill import SpillFile

        if self._spill is None:
            self._spill = SpillFile(self._partial)
        for device in self._devices.values():
            self._spill.add(device.name, device.channels, device.rate_hz, device.joined())
            device.blocks = []
        self._bytes = 0

    def _finish_spilled(
        self, outcome: TrialOutcome, settle_curve: SettleCurve | None, command: Trajectory | None
    ) -> dict[str, Any]:
        self._move_to_disk()
        spill = self._spill
        assert spill is not None  # noqa: S101 - for the type checker: _move_to_disk made it
        for device in self._devices.values():
            tare = layout.device_tare(outcome, device.name)
            attributes = layout.device_attributes(device.rate_hz, device.lost, device.saturated)
            spill.complete(device.name, outcome.started_s, tare, attributes)
        layout.write_outcome(spill.file, outcome)
        layout.write_rest(spill.file, settle_curve, command)
        spill.close()
        self._spill = None
        fsync_file(self._partial)
        return {"bytes": self._partial.stat().st_size}
