"""One TCP connection to the controller, with errors that a person understands."""

import contextlib
import socket

from labrun.devices import DeviceError

PATIENCE_S = 0.05
"""Longest wait of one read or write: a stop must not wait longer for anyone."""
_CONNECT_S = 2.0
_MOST = 65_536
REACH_HINT = (
    "check that the controller is on, its address in the file, and the cable; on an e-Series also that the service is "
    "enabled (Settings, Security, Services)"
)
REOPEN_HINT = (
    "the controller may have been restarted or switched between local and remote control; look at the pendant, then "
    "labrun resume"
)


class Connection:
    """A service of the controller.

    Parameters
    ----------
    service
        What a person calls it.
    host, port
        Where it is.
    interface
        Address of this computer from which to connect; None for the one that routes there.
    """

    def __init__(self, device: str, service: str, host: str, port: int, interface: str | None = None) -> None:
        self._device = device
        self._address = (host, port)
        self._service = f"{service} at {host}:{port}"
        self._interface = interface
        self._socket: socket.socket | None = None

    @property
    def is_open(self) -> bool:
        """Tell whether it was opened, and neither closed nor lost."""
        return self._socket is not None

    def open(self, timeout_s: float = _CONNECT_S) -> None:
        """Connect. Raises DeviceError: nobody answers there, or the interface is not one of this computer."""
        self.close()
        source = None if self._interface is None else (self._interface, 0)
        try:
            connection = socket.create_connection(self._address, timeout_s, source_address=source)
        except OSError as error:
            raise DeviceError(
                self._device, f"cannot reach its {self._service}: {error.strerror or error}", hint=REACH_HINT
            ) from None
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(PATIENCE_S)
        self._socket = connection

    def read(self) -> bytes:
        """Return what has arrived; waits `PATIENCE_S` at most, and returns nothing then.

        Raises DeviceError: the controller has closed the connection, or it is gone.
        """
        connection = self._socket
        if connection is None:
            raise DeviceError(self._device, f"its {self._service} is not connected", hint=REOPEN_HINT)
        try:
            data = connection.recv(_MOST)
        except TimeoutError:
            return b""
        except OSError as error:
            raise self._lost(connection, error.strerror or str(error)) from None
        if not data:
            raise self._lost(connection, "the controller closed it")
        return data

    def write(self, data: bytes) -> None:
        """Send all of it; DeviceError if that is not possible within `PATIENCE_S`."""
        connection = self._socket
        if connection is None:
            raise DeviceError(self._device, f"its {self._service} is not connected", hint=REOPEN_HINT)
        try:
            connection.sendall(data)
        except OSError as error:
            raise self._lost(connection, error.strerror or str(error)) from None

    def close(self) -> None:
        """Disconnect; harmless when not connected."""
        connection, self._socket = self._socket, None
        if connection is None:
            return
        # What was sent last may be a stop: a socket closed over unread data resets the connection, which can lose it.
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_WR)
            connection.setblocking(False)
            while connection.recv(_MOST):
                pass
        connection.close()

    def _lost(self, connection: socket.socket, why: str) -> DeviceError:
        if self._socket is connection:  # not one that another thread has opened in the meantime
            self._socket = None
        connection.close()
        return DeviceError(self._device, f"lost its {self._service}: {why}", hint=REOPEN_HINT)
