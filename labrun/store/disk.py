"""Writing that survives a power cut, and what to say when the disk does not take it."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labrun.errors import StoreError

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def fsync_directory(path: Path) -> None:
    """Make renames and removals in a directory durable."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def fsync_file(path: Path) -> None:
    """Make a closed file's content durable."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_all(descriptor: int, data: bytes) -> None:
    """Write all of `data`: a single write may take only a part, for example when the disk fills up."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def write_all_at(descriptor: int, data: bytes, first: int) -> None:
    """Write all of `data` at a place of the file."""
    view = memoryview(data)
    while view:
        count = os.pwrite(descriptor, view, first)
        view, first = view[count:], first + count


def write_unsynced(path: Path, data: bytes) -> None:
    """Write a file and leave it to the system when it goes to disk."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    try:
        write_all(descriptor, data)
    finally:
        os.close(descriptor)


def write_synced(path: Path, data: bytes) -> None:
    """Write a file and wait until it is on disk; its name becomes durable with `fsync_directory`."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    try:
        write_all(descriptor, data)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace_durably(path: Path, data: bytes) -> None:
    """Put a small file in place whole: at any instant it has its old or its new content."""
    partial = path.with_name(f".{path.name}.partial")
    try:
        write_synced(partial, data)
        partial.rename(path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
    fsync_directory(path.parent)


def free_space(path: Path) -> str:
    """Return the free space of the disk `path` is on, for a person."""
    try:
        free = shutil.disk_usage(path).free
    except OSError:
        return "an unknown amount"
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if free >= size:
            return f"{free / size:.3g} {unit}"
    return f"{free} bytes"


@contextmanager
def saving(what: str, where: Path, saved: str = "what was stored before is untouched") -> Iterator[None]:
    """Turn an `OSError` of the writing inside into a `StoreError` that says what is saved and what is free.

    Parameters
    ----------
    what
        What could not be written, for example ``"trial 12"``.
    where
        The run folder.
    saved
        What the person still has.
    """
    try:
        yield
    except OSError as error:
        code = error.errno
        cause = os.strerror(code) if code is not None else str(error)
        hint = f"see whether {where} can be written"
        if code in _FULL or "No space left" in str(error):
            cause = (
                "the disk is full"
                if code != errno.EFBIG
                else "the file would exceed the size the system allows"
            )
            hint = f"free some space (or move {where} to a larger disk), then labrun resume {where}"
        message = (
            f"{what} could not be written to {where}: {cause}; {free_space(where)} free on this disk; {saved}"
        )
        raise StoreError(message, hint=hint) from error
