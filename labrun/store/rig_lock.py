"""One run at a time on a rig: a lock for every port, on the whole machine."""

import hashlib
import os
import re
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from labrun.errors import RequestError
from labrun.store.locking import FileLock

_SHARED = (Path("/run/lock"), Path("/tmp"))  # noqa: S108  shared by all users is what it is for


def lock_folder() -> Path:
    """Return where the locks of this machine's rigs are: the same folder for every user."""
    for shared in _SHARED:
        if _everyone_writes(shared):
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


def _everyone_writes(folder: Path) -> bool:
    # Asks about the folder and not about this user, so that every user gets the same answer.
    return folder.is_dir() and bool(folder.stat().st_mode & stat.S_IWOTH)


def _real(port: str) -> str:
    return str(Path(port).resolve()) if port.startswith("/") else port


def _file_name(port: str) -> str:
    # Readable, and different for different ports whatever characters they have.
    readable = re.sub(r"[^A-Za-z0-9.-]+", "_", port).strip("_")
    return f"{readable}-{hashlib.blake2b(port.encode(), digest_size=4).hexdigest()}.lock"
