"""Writing that survives a power cut, what to say when the disk takes nothing, and locks that vanish with a process."""

import errno
import fcntl
import hashlib
import json
import os
import platform
import re
import shutil
import stat
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path

from labrun.errors import RecordingError, RequestError, RigBusyError, StoreError

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_LOCKED = {errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK}
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
    with saving(what, folder, "nothing was computed"), tempfile.TemporaryFile(dir=_existing(folder)):
        pass


def _existing(folder: Path) -> Path:
    """Return a folder, or the nearest one above it that exists: on its disk the folder will be made."""
    return next(
        candidate for candidate in (folder.absolute(), *folder.absolute().parents) if candidate.exists()
    )


def lacking_room(folder: Path, needed: float) -> str | None:
    """Return why so many bytes do not fit on the disk of a folder, as a sentence; None if they do."""
    try:
        free = shutil.disk_usage(_existing(folder)).free
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
            free = in_bytes(shutil.disk_usage(_existing(where)).free)
        except OSError:
            free = "an unknown amount"
        message = f"{what} could not be written to {where}: {cause}; {free} free on this disk; {saved}"
        raise StoreError(message, hint=hint) from error


class InaccessibleError(RecordingError):
    """A file that is there cannot be opened now. Nothing says that it is damaged."""


def inaccessible(path: Path, error: BaseException) -> InaccessibleError | None:
    """Return what keeps a file from being opened; None where `error` is about its content."""
    if not isinstance(error, OSError) or error.errno is None:
        return None
    if error.errno in _LOCKED:
        return InaccessibleError(
            f"{path} is open in another program, which has locked it",
            hint="close it there (a notebook, MATLAB, an HDF5 viewer), and repeat the command; the file is not damaged",
        )
    hints = {
        errno.EACCES: f"see who may read it: ls -l {path}",
        errno.EPERM: f"see who may read it: ls -l {path}",
        errno.EMFILE: "close other files, or raise the limit: ulimit -n",
        errno.ENOENT: "see whether it was moved, or whether its disk is mounted",
        errno.EIO: "the disk or the network did not deliver it: look at the system's log (dmesg)",
        errno.ESTALE: "its network folder was exported again; mount it again",
    }
    return InaccessibleError(
        f"{path} cannot be opened: {os.strerror(error.errno)}",
        hint=hints.get(error.errno, "nothing says that the file is damaged"),
    )


@contextmanager
def opening(path: Path) -> Iterator[None]:
    """Turn an OSError of the system into an `InaccessibleError` that says what it is."""
    try:
        yield
    except OSError as error:
        refusal = inaccessible(path, error)
        if refusal is None:
            raise
        raise refusal from error


@contextmanager
def flush_errors() -> Iterator[None]:
    """Turn the RuntimeError of an HDF5 cache that cannot be flushed into the OSError it comes from."""
    try:
        yield
    except RuntimeError as error:
        code = re.search(r"errno = (\d+)", str(error))
        raise OSError(int(code[1]) if code else errno.EIO, str(error)) from error


_SHARED = (Path("/run/lock"), Path("/tmp"))  # noqa: S108  shared by all users is what it is for
_held: "weakref.WeakSet[FileLock]" = weakref.WeakSet()


class FileLock:
    """An advisory lock (flock) on a small file that says who holds it.

    The kernel releases it when the holder dies, however it dies; the file itself stays and means nothing. `path`: the
    file; made when missing. `subject`: what is locked, for the message to whoever comes second.
    """

    def __init__(self, path: Path, subject: str) -> None:
        self.path = path
        self.subject = subject
        self._descriptor: int | None = None

    def acquire(self) -> None:
        """Take the lock or raise at once.

        Raises RigBusyError: someone else holds it: names process id, start and command.
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


def lock_folder() -> Path:
    """Return where the locks of this machine's rigs are: the same folder for every user."""
    for shared in _SHARED:  # about the folder, not about this user: every user gets the same answer
        if shared.is_dir() and shared.stat().st_mode & stat.S_IWOTH:
            return shared / "labrun"
    return Path(tempfile.gettempdir()) / "labrun"


@contextmanager
def lock_ports(ports: Sequence[str], folder: Path | None = None) -> Iterator[None]:
    """Hold every port of a rig while a run uses it.

    Locks vanish with the process that holds them, so a crash leaves none behind.

    Parameters
    ----------
    ports
        Serial ports and network addresses. Two names of one serial port (a link of ``/dev/serial/by-id`` and
        ``/dev/ttyUSB0``) count as one.
    folder
        Where the locks are, if not in the machine's own folder.

    Raises
    ------
    RigBusyError
        Another run holds one of them, whoever started it; names the port and the process. None is held then.
    RequestError
        The locks cannot be written.
    """
    where = lock_folder() if folder is None else folder
    with ExitStack() as held:
        for port in sorted({_real(port) for port in ports}):
            path = where / _file_name(port)
            lock = FileLock(path, f"port {port}")
            try:
                _share(path)
                lock.acquire()
            except OSError as error:
                raise RequestError(
                    f"port {port} cannot be locked against other runs: {path}: {error.strerror or error}",
                    hint=f"make {where} a folder that everyone may write to (mode 1777), or delete it",
                ) from error
            held.callback(lock.release)
        yield


def _share(path: Path) -> None:
    """Make a lock and its folder where they are missing, open to every user whatever this one's umask."""
    if not path.parent.is_dir():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.parent.chmod(0o1777)
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        return
    os.fchmod(descriptor, 0o666)
    os.close(descriptor)


def _real(port: str) -> str:
    return str(Path(port).resolve()) if port.startswith("/") else port


def _file_name(port: str) -> str:
    # Readable, and different for different ports whatever characters they have.
    readable = re.sub(r"[^A-Za-z0-9.-]+", "_", port).strip("_")
    return f"{readable}-{hashlib.blake2b(port.encode(), digest_size=4).hexdigest()}.lock"
