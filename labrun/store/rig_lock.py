"""One run at a time on a rig: a lock for every port, on the whole machine."""

import hashlib
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from labrun.store.locking import FileLock


def lock_folder() -> Path:
    """Return where the locks of this user's rigs are."""
    import platformdirs

    return Path(platformdirs.user_runtime_dir("labrun", appauthor=False)) / "rigs"


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
        Where the locks are, if not in the user's runtime folder.

    Raises
    ------
    RigBusyError
        Another run holds one of them; names the port and the process. None is held then.
    """
    where = lock_folder() if folder is None else folder
    where.mkdir(parents=True, exist_ok=True)
    with ExitStack() as held:
        for port in sorted({_real(port) for port in ports}):
            lock = FileLock(where / _file_name(port), f"port {port}")
            lock.acquire()
            held.callback(lock.release)
        yield


def _real(port: str) -> str:
    return str(Path(port).resolve()) if port.startswith("/") else port


def _file_name(port: str) -> str:
    # Readable, and different for different ports whatever characters they have.
    readable = re.sub(r"[^A-Za-z0-9.-]+", "_", port).strip("_")
    return f"{readable}-{hashlib.blake2b(port.encode(), digest_size=4).hexdigest()}.lock"
