"""Trials durable by one sync each: a log that stands behind their files until these are on disk, too.

Making a file durable takes a sync of its content and one of its directory; on a busy disk these are what a trial
costs. So the bytes of a small trial go to the end of one file first, whose space was written before, and that file is
synced: from then on the trial survives a power cut. Its own file is written next and left to the system, which puts it
on disk in its own time. When the session ends in order, all files are synced and the log is removed; packing, which
ends with a durable ``run.h5``, needs no sync of them at all. So a log that is found tells of a crash: a trial file
that is missing or not as it was written is put back from it. What kill -9 leaves is whole anyway; only a power cut
takes what waited.
"""

import os
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

from labrun.store.disk import fsync_directory, fsync_file, write_all_at, write_synced
from labrun.store.written import digest_of

NAME = ".log"
MOST_OF_A_TRIAL = 256 << 10
"""Bytes of a trial above which writing them twice costs more than the sync that it saves."""
MOST = 64 << 20
"""Bytes of the log, after which the files are synced and it begins anew."""
_STEP = 1 << 20
"""Space is written with zeros so many bytes ahead: to sync what replaces them, the disk need not note a new length."""
_THREADS = 8
"""Syncs asked for together: the file system joins them."""

_MAGIC = b"labtrial"
_FIELDS = struct.Struct("<8sQQ16s")
_HEADER = _FIELDS.size + 8


@dataclass(frozen=True, slots=True)
class Logged:
    """A trial in the log.

    Attributes
    ----------
    digest
        Of its file, as in the journal.
    """

    digest: str
    first: int
    length: int


class TrialLog:
    """The log of one run's trial files.

    Parameters
    ----------
    trials
        The folder of trial files; the log stands in it as ``.log``.
    before
        Called before the log is given up: what else must be durable by then.
    """

    def __init__(self, trials: Path, before: Callable[[], None]) -> None:
        self.path = trials / NAME
        self._before = before
        self._descriptor: int | None = None
        self._end = self._written = self._last = 0
        self._indices: set[int] = set()

    def takes(self, size: int) -> bool:
        """Tell whether a trial of so many bytes goes by the log."""
        return size <= MOST_OF_A_TRIAL

    def append(self, index: int, digest: str, content: bytes) -> None:
        """Make a trial durable: when this returns, it survives a power cut.

        Raises
        ------
        OSError
            The disk is full or fails; the log is as it was.
        """
        if self._end + len(content) > MOST:
            self.settle()
        descriptor = self._open()
        fields = _FIELDS.pack(_MAGIC, index, len(content), bytes.fromhex(digest))
        record = b"".join((fields, _check(fields), content))
        self._last = self._end
        try:
            self._write_ahead(descriptor, self._end + len(record))
            write_all_at(descriptor, record, self._end)
            os.fdatasync(descriptor)
        except OSError:
            self.take_back()
            raise
        self._end += len(record)
        self._written = max(self._written, self._end)
        self._indices.add(index)

    def take_back(self) -> None:
        """Remove the last trial, whose file could not be written. Never raises."""
        if self._descriptor is not None:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._last)
            self._end = self._written = self._last

    def records(self) -> dict[int, Logged]:
        """Return the trials in the log by index; of one that was stored twice, the later."""
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return {}
        found = {}
        at = 0
        while (fields := content[at : at + _FIELDS.size]).startswith(_MAGIC):
            if content[at + _FIELDS.size : at + _HEADER] != _check(fields):
                break
            _, index, length, digest = _FIELDS.unpack(fields)
            first = at + _HEADER
            at = first + length
            if digest_of(content[first:at]) == digest.hex():  # else the power went while it was written
                found[int(index)] = Logged(digest.hex(), first, length)
        return found

    def put_back(self, index: int, logged: Logged) -> None:
        """Make a trial's file what it was, durably, if it is missing or anything else.

        Raises
        ------
        OSError
            The disk is full or fails.
        """
        path = self._file(index)
        if path.exists() and digest_of(path.read_bytes()) == logged.digest:
            return
        with self.path.open("rb") as file:
            file.seek(logged.first)
            content = file.read(logged.length)
        partial = path.with_name(f".{path.name}.partial")
        write_synced(partial, content)
        partial.replace(path)
        fsync_directory(path.parent)

    def settle(self) -> None:
        """Make the files of all trials in the log durable, then remove it; nothing happens where there is none.

        Raises
        ------
        OSError
            The disk fails; the log stays.
        """
        if not self.path.exists():
            self.close()
            return
        from concurrent.futures import ThreadPoolExecutor

        self._before()
        indices = self._indices | self.records().keys() if self._descriptor is None else self._indices
        files = [path for path in map(self._file, indices) if path.exists()]
        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(fsync_file, files))
        fsync_directory(self.path.parent)
        self.remove()

    def remove(self) -> None:
        """Give the log up: everything in it is durable elsewhere."""
        self.close()
        self.path.unlink(missing_ok=True)

    def close(self) -> None:
        """Release the file and forget what is in it."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
        self._end = self._written = self._last = 0
        self._indices = set()

    def _file(self, index: int) -> Path:
        return self.path.with_name(f"{index:06d}.h5")

    def _open(self) -> int:
        if self._descriptor is not None and not self._is_there(self._descriptor):
            self.close()
        if self._descriptor is None:
            self.settle()  # of a session before, if one left it
            self._descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
            fsync_directory(self.path.parent)
        return self._descriptor

    def _is_there(self, descriptor: int) -> bool:
        try:
            return os.path.samestat(self.path.stat(), os.fstat(descriptor))
        except FileNotFoundError:
            return False

    def _write_ahead(self, descriptor: int, end: int) -> None:
        if end <= self._written:
            return
        with suppress(OSError):  # without room for that, the trial itself may still have some
            write_all_at(descriptor, bytes(_STEP), self._written)
            self._written += _STEP


def _check(fields: bytes) -> bytes:
    return blake2b(fields, digest_size=8).digest()
