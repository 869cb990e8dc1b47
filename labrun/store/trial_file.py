"""The file of one trial: what is in it, and whether it is whole.

Plain HDF5. The attribute ``trial`` is JSON: the outcome, and the columns of every dataset. Each dataset is one table,
a device's, ``command`` or ``settle``: a row a sample, times first. Two or three datasets and one attribute, because
these are what a small file costs. ``run.h5`` has every signal by itself, with its unit.
"""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from h5py import h5a, h5d, h5f, h5p, h5s, h5t, string_dtype

from labrun.arrays import FloatArray
from labrun.errors import RecordingError, StoreError
from labrun.signals import MEMORY_ROWS, TIMES, LongSignals, Signals, joined
from labrun.store.disk import flush_errors, require_room
from labrun.store.table import AXIS, HEAD, MIDDLE, TAIL
from labrun.store.trial import SETTLE, TrialOutcome, json_ready

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
    if device in RESERVED or not _fits(device):
        raise StoreError(
            f"a device cannot be stored under the name {device!r}",
            hint=f"choose a name without '/', other than {', '.join(sorted(RESERVED))}",
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
    found = (path for path in trials.iterdir() if path.suffix == ".h5" and path.stem.isdigit())
    return {int(path.stem): path for path in sorted(found)}


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
    dataset is read instead. Raises RecordingError: the file is cut short or altered; says how.
    """
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
        raise RecordingError(f"{path} cannot be read: {error}") from error
    if outcome.index != int(path.stem):
        raise RecordingError(f"{path} holds trial {outcome.index}")
    return outcome
