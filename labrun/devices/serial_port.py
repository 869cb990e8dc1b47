"""A serial port whose troubles are told in words a person at the bench understands."""

import contextlib
import errno
import os
import threading
from pathlib import Path

import serial

from labrun.errors import DeviceError

_REPLUG = "check its cable and power; once it is back, labrun resume continues"


class SerialPort:
    """One serial port, held exclusively: two readers on one port take each other's bytes.

    Parameters
    ----------
    port
        For example ``/dev/ttyUSB0``.
    timeout_s
        How long `read` waits for the first byte, s.

    Attributes
    ----------
    serial
        The pyserial object while open, for libraries that want it.
    """

    def __init__(self, device: str, port: str, baud: int, *, timeout_s: float = 0.02) -> None:
        self.device = device
        self.port = port
        self._baud = baud
        self._timeout_s = timeout_s
        self._writing = threading.Lock()
        self.serial: serial.Serial | None = None

    @property
    def is_open(self) -> bool:
        """Tell whether it is open."""
        return self.serial is not None

    def open(self) -> None:
        """Open it, exclusively, with what a previous program left in its input thrown away.

        Raises
        ------
        DeviceError
            It is not there, may not be used, or is held by another program.
        """
        self.close()
        try:
            opened = serial.Serial(
                self.port, self._baud, timeout=self._timeout_s, write_timeout=1.0, exclusive=True
            )
        except Exception as error:  # a SerialException is an OSError; termios.error and OverflowError are not
            raise self._not_opened(error) from error
        self.serial = opened
        # Some adapters know no such mode, nor does a pty; doctor tells about latency.
        with contextlib.suppress(OSError, ValueError, NotImplementedError, AttributeError):
            opened.set_low_latency_mode(True)
        self.discard_input()

    @property
    def file(self) -> int:
        """Its file descriptor, which does not block.

        Raises
        ------
        DeviceError
            Not open, or unplugged.
        """
        try:
            return int(self._opened().fileno())
        except (OSError, TypeError) as error:
            raise self._gone(error) from error

    def read(self, most: int = 4096) -> bytes:
        """Return what has arrived, up to `most` bytes; waits up to `timeout_s` for the first one.

        Raises
        ------
        DeviceError
            Not open, or unplugged.
        """
        port = self._opened()
        try:
            first = port.read(1)
            waiting = port.in_waiting if first else 0
            return bytes(first + port.read(min(waiting, most - 1))) if waiting and most > 1 else bytes(first)
        except (OSError, TypeError) as error:  # TypeError: closed by another thread in the midst of it
            raise self._gone(error) from error

    def write(self, data: bytes) -> None:
        """Send all of these bytes; messages of two threads do not mix.

        Raises
        ------
        DeviceError
            Not open, unplugged, or the port takes nothing more.
        """
        port = self._opened()
        try:
            with self._writing:
                port.write(data)
        except (OSError, TypeError) as error:  # a SerialTimeoutException is an OSError
            raise self._gone(error) from error

    def discard_input(self) -> None:
        """Throw away what has arrived.

        Raises
        ------
        DeviceError
            Not open, or unplugged.
        """
        port = self._opened()
        try:
            port.reset_input_buffer()
        except Exception as error:  # termios.error is none of OSError
            raise self._gone(error) from error

    def close(self) -> None:
        """Close it; harmless when it is not open. Never raises."""
        port, self.serial = self.serial, None
        if port is not None:
            with contextlib.suppress(Exception):  # a port that is gone is closed
                port.close()

    def _opened(self) -> serial.Serial:
        port = self.serial  # once: another thread may close it in the midst of this
        if port is None:
            raise DeviceError(
                self.device, f"port {self.port} is not open", hint="open() comes before any other call"
            )
        return port

    def _gone(self, error: Exception) -> DeviceError:
        return DeviceError(self.device, f"port {self.port} was unplugged or closed ({error})", hint=_REPLUG)

    def _not_opened(self, error: Exception) -> DeviceError:
        number = getattr(error, "errno", None)
        if not Path(self.port).exists() or number in (errno.ENOENT, errno.ENXIO, errno.EIO, errno.ENODEV):
            return DeviceError(
                self.device,
                f"cannot find the port {self.port}",
                hint="plug it in, or set its port; labrun doctor lists the ports of this machine",
            )
        if number == errno.EACCES or not os.access(self.port, os.R_OK | os.W_OK):
            return DeviceError(
                self.device,
                f"no permission to use {self.port}",
                hint="sudo usermod -aG dialout $USER, then log in again",
            )
        if number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK) or "exclusively lock" in str(error):
            return DeviceError(
                self.device,
                f"another program holds {self.port}",
                hint=f"fuser {self.port} names it: close that program, then try again",
            )
        return DeviceError(self.device, f"{self.port} cannot be opened: {error}", hint=_REPLUG)
