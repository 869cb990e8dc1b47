"""Two line protocols of the controller: dashboard (short questions, stop button), and programs to the script port.

What becomes of a program is heard at the primary port. A package of it is ``size u32, type u8, payload``, big-endian.
Type 20 is a message: ``time u64, source u8, kind u8``, then for kind 10 (a program failed) ``line i32, column i32,
text`` and for kind 6 (the controller reports) ``code i32, argument i32, level i32, data type u32, data u32, text`` (UR
client interface; src/primary of `UniversalRobots/Universal_Robots_Client_Library`).
"""

import contextlib
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from labrun.devices import Clock, DeviceError
from labrun.devices.listening import Listener
from labrun_plugins.ur5.connection import PATIENCE_S, Connection
from labrun_plugins.ur5.motion import STOP, STOP_PROGRAM
from labrun_plugins.ur5.rtde import readable
from labrun_plugins.ur5.settings import Ur5Settings

_ANSWER_S = 1.0
_DASHBOARD_LOCK_S = 0.03
"""A stop waits this long for another thread's question, and then goes out all the same."""
_STOP_ANSWERS = ("stopped", "failed to execute: stop")
_MOST_ANSWER = 4096
_STRANGER_HINT = (
    "is this the address of a UR controller (not PolyScope X), and is it past booting? Look at the pendant"
)
_HINT = "the arm may have been switched to local control, which closes this service; look at the pendant"


class Dashboard:
    """The dashboard server of the controller."""

    def __init__(self, device: str, settings: Ur5Settings, clock: Clock) -> None:
        self._device = device
        self._clock = clock
        self._connection = Connection(
            device, "dashboard server", settings.host, settings.dashboard_port, settings.interface
        )
        self._lock = threading.Lock()
        self._rest = b""
        self._stops = 0
        self._owes_reply = False

    def open(self, timeout_s: float = 2.0) -> None:
        """Connect, and hear its greeting; DeviceError if there is none."""
        self._connection.open(timeout_s)
        self._rest = b""
        self._stops = 0
        self._owes_reply = False
        try:
            self._line("with its greeting", _STRANGER_HINT)  # a line in front of any answer
        except DeviceError:
            self._connection.close()
            raise

    def ask(self, command: str) -> str:
        """Send one command, and return the reply.

        Raises DeviceError: no reply within a second, or the connection is lost.
        """
        with self._lock:
            if self._owes_reply:  # which may come yet, and would be taken for that to the next question
                self.open()
            self._connection.write(command.encode("ascii") + b"\n")
            while True:
                self._owes_reply = True
                reply = self._line(repr(command))
                self._owes_reply = False
                # The reply to a stop that another thread has sent in between belongs to nobody.
                if self._stops > 0 and reply.lower().startswith(_STOP_ANSWERS):
                    self._stops -= 1
                    continue
                return reply

    def stop_now(self) -> bool:
        """Send ``stop`` without waiting for the reply, whoever is asking at the moment; tell whether it left."""
        locked = self._lock.acquire(timeout=_DASHBOARD_LOCK_S)
        try:
            self._connection.write(b"stop\n")
            self._stops += 1
        except DeviceError:
            return False
        finally:
            if locked:
                self._lock.release()
        return True

    def hear_stop(self) -> bool:
        """Wait for the reply to a stop; tell whether there was one."""
        try:
            return self._line("'stop'").lower().startswith(_STOP_ANSWERS[0])
        except DeviceError:
            return False

    def remote_control(self) -> bool | None:
        """Tell whether the arm takes orders from outside; None where that is not known (CB3)."""
        reply = self.ask("is in remote control").lower()
        return {"true": True, "false": False}.get(reply)

    def close(self) -> None:
        """Disconnect; harmless when not connected."""
        if self._connection.is_open:
            with contextlib.suppress(DeviceError):
                self._connection.write(b"quit\n")
        self._connection.close()

    def _line(self, what: str, hint: str = _HINT) -> str:
        deadline_s = self._clock.now() + _ANSWER_S
        while b"\n" not in self._rest:
            if self._clock.now() > deadline_s or len(self._rest) > _MOST_ANSWER:
                raise DeviceError(
                    self._device,
                    f"its dashboard server does not answer {what} within {_ANSWER_S:g} s",
                    hint=hint,
                )
            self._rest += self._connection.read()
        line, self._rest = self._rest.split(b"\n", 1)
        return readable(line)


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
        lines: list[str] = []
        rest = self._rest
        rest += data
        begin = 0
        while len(rest) - begin >= _HEADER.size:
            size, kind = _HEADER.unpack_from(rest, begin)
            if not _HEADER.size <= size <= _MOST:
                self.broken = True
                rest.clear()
                return lines
            if len(rest) - begin < size:
                break
            if kind == _MESSAGE:
                complaint = complaint_of(bytes(rest[begin + _HEADER.size : begin + size]))
                if complaint:
                    lines.append(complaint)
            begin += size
        del rest[:begin]
        return lines


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

        `wanted`: asked right before the text leaves: a stop that came in between wins. Raises DeviceError: it cannot be
        sent.
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
