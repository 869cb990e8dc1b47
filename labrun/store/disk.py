"""Writing that survives a power cut, and what to say when the disk does not take it."""

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labrun.errors import StoreError

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_METADATA = 1 << 16
"""Bytes that are enough for what HDF5 writes beside the samples of a trial."""
_ASKED_FOR = 1 << 18
"""Bytes above which room for a file is set aside, which takes longer than asking what is free."""


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


def replace_durably(path: Path, data: bytes) -> None:
    """Put a small file in place whole: at any instant it has its old or its new content."""
    partial = path.with_name(f".{path.name}.partial")
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.rename(path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
    fsync_directory(path.parent)


def require_room(path: Path, count: int) -> None:
    """Raise OSError where a file at `path` would find no room for so many bytes.

    HDF5 cannot be closed in order once a write of it has failed, so the disk is asked before: for its free space, and
    where much is to be written, to set it aside.
    """
    if count < _ASKED_FOR:
        disk = os.statvfs(path.parent)
        if disk.f_bavail * disk.f_frsize < count + _METADATA:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    try:
        os.posix_fallocate(descriptor, 0, count + _METADATA)
    finally:
        os.close(descriptor)


def require_writable(folder: Path, what: str) -> None:
    """Raise StoreError where nothing can be written to a folder, or to the one it would be made in.

    Parameters
    ----------
    what
        What is to be written there, for example ``"the fit"``.
    """
    existing = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
    with saving(what, folder, "nothing was computed"), tempfile.TemporaryFile(dir=existing):
        pass


def lacking_room(folder: Path, needed: float) -> str | None:
    """Return why so many bytes do not fit on the disk of a folder, as a sentence; None if they do."""
    existing = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
    try:
        free = shutil.disk_usage(existing).free
    except OSError:
        return None
    if needed <= free:
        return None
    return f"the run needs {in_bytes(needed)}, but {in_bytes(free)} are free on the disk of {folder}"


def in_bytes(count: float) -> str:
    """Return a number of bytes for a person: ``"170 MB"``."""
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count:.0f} bytes"


@contextmanager
def saving(what: str, where: Path, saved: str = "what was stored before is untouched") -> Iterator[None]:
    """Turn an `OSError` of the writing inside into a `StoreError` that says what is saved and what is free.

    Parameters
    ----------
    what
        What could not be written, for example ``"trial 12"``.
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
        try:
            free = in_bytes(shutil.disk_usage(where).free)
        except OSError:
            free = "an unknown amount"
        message = f"{what} could not be written to {where}: {cause}; {free} free on this disk; {saved}"
        raise StoreError(message, hint=hint) from error


@contextmanager
def flush_errors() -> Iterator[None]:
    """Turn the RuntimeError of an HDF5 cache that cannot be flushed into the OSError it comes from."""
    try:
        yield
    except RuntimeError as error:
        code = re.search(r"errno = (\d+)", str(error))
        raise OSError(int(code[1]) if code else errno.EIO, str(error)) from error
