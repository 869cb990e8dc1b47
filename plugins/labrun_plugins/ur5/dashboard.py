"""Dashboard client: short questions and the stop button, one line each."""

import contextlib
import threading

from labrun.devices import Clock, DeviceError
from labrun_plugins.ur5.connection import Connection
from labrun_plugins.ur5.packages import readable
from labrun_plugins.ur5.settings import Ur5Settings

_ANSWER_S = 1.0
_LOCK_S = 0.03
"""A stop waits this long for another thread's question, and then goes out all the same."""
_STOP_ANSWERS = ("stopped", "failed to execute: stop")
_MOST = 4096
_STRANGER_HINT = (
    "is this the address of a UR controller (not PolyScope X), and is it past booting? Look at the pendant"
)
_HINT = "the arm may have been switched to local control, which closes this service; look at the pendant"


class Dashboard:
    """The dashboard server of the controller.

    Parameters
    ----------
    device, settings
        Name and table in the experiment file.
    clock
        For the time limits.
    """

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

        Raises
        ------
        DeviceError
            No reply within a second, or the connection is lost.
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
        locked = self._lock.acquire(timeout=_LOCK_S)
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
        """Return whether the arm takes orders from outside; None where that is not known (CB3)."""
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
            if self._clock.now() > deadline_s or len(self._rest) > _MOST:
                raise DeviceError(
                    self._device,
                    f"its dashboard server does not answer {what} within {_ANSWER_S:g} s",
                    hint=hint,
                )
            self._rest += self._connection.read()
        line, self._rest = self._rest.split(b"\n", 1)
        return readable(line)
