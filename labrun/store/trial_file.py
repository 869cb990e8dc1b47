"""The file of one trial: what is in it, and whether it is whole.

Plain HDF5. The attribute ``trial`` is JSON: the outcome, and the columns of every dataset. Each dataset is one table,
a device's, ``command`` or ``settle``: a row a sample, times first. Two or three datasets and one attribute, because
these are what a small file costs. ``run.h5`` has every signal by itself, with its unit.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from h5py import h5a, h5d, h5f, h5p, h5s, h5t, string_dtype

from labrun.arrays import FloatArray
from labrun.devices import Channel, Samples, Trajectory
from labrun.errors import RecordingError, StoreError
from labrun.signals import MEMORY_ROWS, TIMES, LongSignals, Signals, joined
from labrun.store.disk import (
    flush_errors,
    fsync_directory,
    fsync_file,
    inaccessible,
    opening,
    require_room,
    saving,
    write_all,
)
from labrun.store.timing import ClockMap
from labrun.store.trial import AXIS, HEAD, MIDDLE, SETTLE, TAIL, TrialOutcome, json_ready

COMMAND = "command"
"""Name of the signals that tell the commanded joint angles."""
BESIDE = frozenset({COMMAND, SETTLE})
"""Signals of a trial that are no device's."""
RECORD = "record"
"""Group of a packed run with its texts."""
RESERVED = BESIDE | {RECORD, AXIS, *HEAD, *MIDDLE, *TAIL}
"""What stands beside the devices in a trial's file or a packed run."""
_HEAD = b"trial"
_SCALAR = h5s.create(h5s.SCALAR)
_TEXT = string_dtype()
_TEXT_TYPE = h5t.py_create(_TEXT, logical=True)
_NO_TIMES = h5p.create(h5p.DATASET_CREATE)
_NO_TIMES.set_obj_track_times(False)  # the same content gives the same bytes


def _access(*, locked: bool) -> h5p.PropFAID:
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fclose_degree(h5f.CLOSE_STRONG)  # closed means closed, whatever objects are still referred to
    if not locked:
        access.set_file_locking(False, True)
    return access


_LOCKED, _UNLOCKED = _access(locked=True), _access(locked=False)


def check_names(device: str, channels: Sequence[str]) -> None:
    """Raise StoreError where a name cannot stand in a file beside the names labrun uses itself."""
    if device in RESERVED or not _fits(device) or "." in device:
        raise StoreError(
            f"a device cannot be stored under the name {device!r}",
            hint=f"choose a name without '/' and '.' (its channels are {device}.NAME), other than "
            f"{', '.join(sorted(RESERVED))}",
        )
    check_columns(f"device {device}: channel", channels)


def check_columns(what: str, names: Sequence[str]) -> None:
    """Raise StoreError where a signal cannot be stored under its name; `what` says whose it is."""
    for name in names:
        if name in TIMES or not _fits(name) or names.count(name) > 1:
            raise StoreError(
                f"{what} {name!r} cannot be stored",
                hint=f"names differ, have no '/', and are none of {', '.join(TIMES)}",
            )


def _fits(name: str) -> bool:
    return bool(name) and name != "." and not {"/", "\0"} & set(name) and name.isprintable()


def trial_files(trials: Path) -> dict[int, Path]:
    """Return the trial files of a folder by index, in order; empty if there is no such folder."""
    if not trials.is_dir():
        return {}
    paths = (path for path in trials.iterdir() if path.suffix == ".h5" and path.stem.isdigit())
    return {int(path.stem): path for path in sorted(paths)}


def write_trial(path: Path, outcome: TrialOutcome, tables: Iterable[Signals | LongSignals]) -> None:
    """Write a trial's file; memory stays bounded. Raises OSError: the disk is full or fails."""
    tables = list(tables)
    require_room(path, sum(8 * len(table) * (len(TIMES) + len(table.columns)) for table in tables))
    with flush_errors(), closing(h5f.create(os.fsencode(path), h5f.ACC_TRUNC, fapl=_LOCKED)) as file:
        heads = {}
        for table in tables:
            heads[table.name] = _write_table(file, table)
        text = json.dumps({"outcome": outcome.to_record(), "signals": heads}, default=json_ready)
        h5a.create(file, _HEAD, _TEXT_TYPE, _SCALAR).write(np.array(text, dtype=_TEXT))


def _write_table(file: h5f.FileID, table: Signals | LongSignals) -> dict[str, Any]:
    head = table.head if isinstance(table, LongSignals) else table
    times = [name for name in TIMES if getattr(head, name) is not None]
    shape = (len(table), len(times) + len(table.columns))
    dataset = h5d.create(
        file, table.name.encode(), h5t.NATIVE_DOUBLE, h5s.create_simple(shape), dcpl=_NO_TIMES
    )
    first = 0
    for piece in table.pieces():
        rows = np.column_stack([*(getattr(piece, name) for name in times), piece.values])
        if len(rows):
            where = dataset.get_space()
            where.select_hyperslab((first, 0), rows.shape)
            dataset.write(h5s.create_simple(rows.shape), where, rows)
        first += len(rows)
    return {"times": times, **_described(head)}


def _described(head: Signals) -> dict[str, Any]:
    """Return what is known of signals beside their samples, JSON-ready."""
    return {
        "columns": head.columns,
        "units": head.units,
        "tare": dict(head.tare),
        "rate_hz": None if np.isnan(head.rate_hz) else head.rate_hz,
        "lost": head.lost,
        "saturated": head.saturated,
        "clock_glitches": head.clock_glitches,
    }


class TrialFile:
    """A trial's file, open for reading within a ``with``.

    `locked`: whether HDF5 locks it, which a network folder may refuse or hand on to the machine that runs. Raises
    OSError, KeyError, ValueError: the file is missing, cut short, or no trial's.
    """

    def __init__(self, path: Path, *, locked: bool = True) -> None:
        access = _LOCKED if locked else _UNLOCKED
        self._file = h5f.open(os.fsencode(path), h5f.ACC_RDONLY, fapl=access)
        try:
            text = np.empty((), dtype=_TEXT)
            h5a.open(self._file, _HEAD).read(text)
            raw = text.item()
            head: dict[str, Any] = json.loads(raw)
            self.outcome = TrialOutcome.from_record(head["outcome"])
            self._tables: dict[str, dict[str, Any]] = head["signals"]
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> "TrialFile":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def tables(self) -> dict[str, LongSignals]:
        """Return all tables by name; their samples are read when asked for, while the file is open."""
        return {name: self._table(name, dict(known)) for name, known in self._tables.items()}

    def _table(self, name: str, known: dict[str, Any]) -> LongSignals:
        dataset = h5d.open(self._file, name.encode())
        count, width = dataset.shape
        times = known.pop("times")

        def made(rows: FloatArray) -> Signals:
            return signals_of(name, times, known, rows)

        def pieces(start: int) -> Iterator[Signals]:
            where = dataset.get_space()
            for first in range(start, max(count, start + 1), MEMORY_ROWS):
                rows = np.empty((min(MEMORY_ROWS, count - first), width))
                if rows.size:
                    where.select_hyperslab((first, 0), rows.shape)
                    dataset.read(h5s.create_simple(rows.shape), where, rows)
                yield made(rows)

        return LongSignals(made(np.empty((0, width))), count, pieces)


def signals_of(name: str, times: Sequence[str], known: Mapping[str, Any], rows: FloatArray) -> Signals:
    """Return signals from rows of samples, times first, and what else is known of them."""
    axes = dict(zip(times, rows.T, strict=False))
    return Signals(
        name,
        tuple(known["columns"]),
        tuple(known["units"]),
        axes["time_s"],
        rows[:, len(times) :],
        known["tare"],
        axes.get("device_time_s"),
        axes.get("host_time_s"),
        np.nan if known["rate_hz"] is None else known["rate_hz"],
        known["lost"],
        known["saturated"],
        known["clock_glitches"],
    )


def digest_of(content: bytes) -> str:
    """Return the digest of a trial's file that stands in the journal."""
    return blake2b(content, digest_size=16).hexdigest()


def check(path: Path, described: Mapping[str, Any] | None) -> TrialOutcome:
    """Read a trial's outcome after making sure that its file is whole.

    `described`: the journal's ``trial`` event of this file (size and digest); None where that line was lost: then every
    dataset is read instead. Raises RecordingError: the file is cut short or altered; says how. InaccessibleError: it
    cannot be opened now.
    """
    with opening(path):
        return _checked(path, described)


def _checked(path: Path, described: Mapping[str, Any] | None) -> TrialOutcome:
    size = path.stat().st_size
    if described is not None and described.get("bytes", size) != size:
        raise RecordingError(f"{path} has {size} bytes of the {described['bytes']} that were written")
    digest = None if described is None else described.get("blake2b")
    if digest is not None and digest_of(path.read_bytes()) != digest:
        raise RecordingError(f"{path} is not what was written: its content changed on the disk")
    try:
        with TrialFile(path) as file:
            outcome = file.outcome
            if described is None:
                for table in file.tables().values():
                    joined(table.pieces())
    except Exception as error:  # a damaged file fails anywhere in HDF5, in many ways
        raise inaccessible(path, error) or RecordingError(f"{path} cannot be read: {error}") from error
    if outcome.index != int(path.stem):
        raise RecordingError(f"{path} holds trial {outcome.index}")
    return outcome


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
