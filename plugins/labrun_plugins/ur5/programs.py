"""Sends programs to the script port, and hears at the primary port what becomes of them.

A package of the primary port is ``size u32, type u8, payload``, big-endian. Type 20 is a message: ``time u64, source
u8, kind u8``, then for kind 10 (a program failed) ``line i32, column i32, text`` and for kind 6 (the controller
reports) ``code i32, argument i32, level i32, data type u32, data u32, text`` (UR client interface; src/primary of
`UniversalRobots/Universal_Robots_Client_Library`).
"""

import contextlib
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from labrun.devices import DeviceError
from labrun.devices.listening import Listener
from labrun_plugins.ur5.connection import PATIENCE_S, Connection
from labrun_plugins.ur5.packages import readable
from labrun_plugins.ur5.script import STOP, STOP_PROGRAM
from labrun_plugins.ur5.settings import Ur5Settings

_HEADER = struct.Struct(">IB")
_MESSAGE = 20
_PREFIX = struct.Struct(">QbB")
_EXCEPTION, _REPORT = 10, 6
_EXCEPTION_PLACE = struct.Struct(">ii")
_REPORT_HEAD = struct.Struct(">iiiII")
_VIOLATION = 3
"""Least level of a report that ends a move: 3 violation, 4 fault; 2, warnings, may be about a fan."""
_DEBUG = 128
_MOST = 65_536


@dataclass
class PrimaryStream:
    """Picks complaints out of what a primary port sends, and skips the rest (its state at 10 Hz)."""

    broken: bool = False
    _rest: bytearray = field(default_factory=bytearray)

    def feed(self, data: bytes) -> list[str]:
        """Return the complaints that are complete now, each as one line."""
        if self.broken:
            return []
        found: list[str] = []
        rest = self._rest
        rest += data
        begin = 0
        while len(rest) - begin >= _HEADER.size:
            size, kind = _HEADER.unpack_from(rest, begin)
            if not _HEADER.size <= size <= _MOST:
                self.broken = True
                rest.clear()
                return found
            if len(rest) - begin < size:
                break
            if kind == _MESSAGE:
                complaint = complaint_of(bytes(rest[begin + _HEADER.size : begin + size]))
                if complaint:
                    found.append(complaint)
            begin += size
        del rest[:begin]
        return found


def complaint_of(payload: bytes) -> str:
    """Return what a message complains about; empty if it is none."""
    if len(payload) < _PREFIX.size:
        return ""
    _, _, kind = _PREFIX.unpack_from(payload)
    body = payload[_PREFIX.size :]
    if kind == _EXCEPTION and len(body) >= _EXCEPTION_PLACE.size:
        line, column = _EXCEPTION_PLACE.unpack_from(body)
        return f"line {line}, column {column}: {readable(body[_EXCEPTION_PLACE.size :])}"
    if kind == _REPORT and len(body) >= _REPORT_HEAD.size:
        code, argument, level, _, _ = _REPORT_HEAD.unpack_from(body)
        if _VIOLATION <= level < _DEBUG:
            return f"C{code}A{argument} {readable(body[_REPORT_HEAD.size :])}".strip()
    return ""


_LOCK_S = 0.03
_COMPLAINTS = 20


class Programs:
    """Both text ports of the controller.

    The script port is opened anew for each program: a connection from before a switch to remote control stays deaf.

    Parameters
    ----------
    device, settings
        Name and table in the experiment file.
    """

    def __init__(self, device: str, settings: Ur5Settings) -> None:
        self._script = Connection(
            device, "script port", settings.host, settings.script_port, settings.interface
        )
        self._primary = Connection(
            device, "primary port", settings.host, settings.primary_port, settings.interface
        )
        self._stream = PrimaryStream()
        self._lock = threading.Lock()
        self._complaints: list[str] = []
        self._idle = threading.Event()
        self._listener = Listener(f"{device} messages", self._hear)

    def open(self) -> None:
        """Connect both; DeviceError if one is not there."""
        self._script.open()
        self._open_primary()
        self._listener.start()

    def send(self, program: str, wanted: Callable[[], bool]) -> bool:
        """Send a program, which takes the place of the one that runs; tell whether it was.

        Parameters
        ----------
        program
            Its text.
        wanted
            Asked right before the text leaves: a stop that came in between wins.

        Raises
        ------
        DeviceError
            It cannot be sent.
        """
        with self._lock:
            self._complaints = []
            if not self._primary.is_open:
                self._open_primary()
            self._script.open()
            if not wanted():
                return False
            self._script.write(program.encode("ascii"))
            return True

    def stop_now(self) -> bool:
        """Send the stop, at once and whoever is sending; tell whether it left."""
        locked = self._lock.acquire(timeout=_LOCK_S)
        try:
            return self._said(self._script, STOP) or self._said(self._primary, STOP_PROGRAM)
        finally:
            if locked:
                self._lock.release()

    def stop_anew(self, patience_s: float = PATIENCE_S) -> bool:
        """Send the stop over a new connection; tell whether it left."""
        with contextlib.suppress(DeviceError):
            self._script.open(patience_s)
            return self._said(self._script, STOP)
        return False

    def complaint(self) -> str:
        """Return what the controller says is wrong with the last program; empty if nothing."""
        return self._complaints[0] if self._complaints else ""

    def close(self) -> None:
        """Disconnect; harmless when not connected."""
        self._listener.stop()
        self._script.close()
        self._primary.close()

    def _open_primary(self) -> None:
        self._primary.open()
        self._stream = PrimaryStream()

    def _hear(self) -> None:
        """Read both: a controller drops a client that does not, and the script port has nothing to say."""
        for connection in (self._primary, self._script):
            try:
                data = connection.read()
            except DeviceError:  # opened again with the next program
                self._idle.wait(PATIENCE_S)
                continue
            if connection is self._primary:
                self._complaints = [*self._complaints, *self._stream.feed(data)][:_COMPLAINTS]

    @staticmethod
    def _said(connection: Connection, text: str) -> bool:
        try:
            connection.write(text.encode("ascii"))
        except DeviceError:
            return False
        return True
