"""Locks that vanish with the process that holds them."""

import fcntl
import json
import os
import platform
import weakref
from datetime import UTC, datetime
from pathlib import Path

from labrun.errors import RigBusyError

_held: "weakref.WeakSet[FileLock]" = weakref.WeakSet()


class FileLock:
    """An advisory lock (flock) on a small file that says who holds it.

    The kernel releases it when the holder dies, however it dies; the file itself stays and means nothing.

    Parameters
    ----------
    path
        The file; made when missing.
    subject
        What is locked, for the message to whoever comes second.
    """

    def __init__(self, path: Path, subject: str) -> None:
        self.path = path
        self.subject = subject
        self._descriptor: int | None = None

    @property
    def held(self) -> bool:
        """Whether this object holds the lock."""
        return self._descriptor is not None

    def acquire(self) -> None:
        """Take the lock or raise at once.

        Raises
        ------
        RigBusyError
            Someone else holds it: names process id, start and command.
        """
        descriptor = _opened(self.path)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = _holder(descriptor)
            os.close(descriptor)
            raise RigBusyError(
                f"{self.subject} is in use by {holder}",
                hint="wait until it ends, or stop it with Ctrl-C in its terminal",
            ) from None
        note = {
            "pid": os.getpid(),
            "machine": platform.node(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
            "subject": self.subject,
        }
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, json.dumps(note).encode(), 0)
        self._descriptor = descriptor
        _held.add(self)

    def release(self) -> None:
        """Give the lock back; harmless when not held."""
        if self._descriptor is not None:
            fcntl.flock(self._descriptor, fcntl.LOCK_UN)
            self._forget()

    def _forget(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
        _held.discard(self)


def _opened(path: Path) -> int:
    # Made only if it is missing: in a sticky folder the kernel refuses O_CREAT on a file of another user.
    try:
        return os.open(path, os.O_RDWR)
    except FileNotFoundError:
        return os.open(path, os.O_RDWR | os.O_CREAT, 0o666)


def _holder(descriptor: int) -> str:
    try:
        note = json.loads(os.pread(descriptor, 4096, 0))
        return f"process {note['pid']} since {note['since']}"
    except (ValueError, KeyError, OSError):
        return "another process"


def _forget_in_child() -> None:
    # A forked child shares the open file: it would keep the lock after its parent died.
    for lock in list(_held):
        lock._forget()


os.register_at_fork(after_in_child=_forget_in_child)
