"""Voltages from another program over TCP: for cards that NI-DAQmx does not drive.

The client sends lines, ``start <rate>`` and ``stop``. The server answers the first with one line, ``voltages <rate>
<model> <serial>``, and then sends blocks until ``stop`` or the end of the connection. A block is
``LRV1 | count u32 | first u64 | count x 6 x f64``, all big-endian: how many samples, the number of the first one since
the start, and the voltages of gauge 1 to 6 of each.
"""

import socket
import struct
from contextlib import suppress

import numpy as np

from labrun.devices import Clock, DeviceError
from labrun_plugins.ati_daq.reader import Card, Voltages
from labrun_plugins.ati_daq.settings import GAUGES, AtiDaqSettings

MAGIC = b"LRV1"
MOST_SAMPLES = 16_384
_HEADER = struct.Struct(">4sIQ")
_SAMPLE_BYTES = 8 * GAUGES
_FARTHEST = 1 << 53


class BlockParser:
    """Puts blocks together from whatever pieces arrive. After bytes that are no block, `broken` says so for ever."""

    def __init__(self) -> None:
        self.broken = False
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[Voltages]:
        """Take bytes; return the blocks that are complete."""
        if self.broken:
            return []
        self._rest += data
        blocks: list[Voltages] = []
        while len(self._rest) >= _HEADER.size:
            magic, count, first = _HEADER.unpack_from(self._rest)
            if magic != MAGIC or not 1 <= count <= MOST_SAMPLES or first > _FARTHEST:
                self.broken = True
                self._rest.clear()
                break
            end = _HEADER.size + count * _SAMPLE_BYTES
            if len(self._rest) < end:
                break
            values = np.frombuffer(bytes(self._rest[_HEADER.size : end]), ">f8").reshape(count, GAUGES)
            blocks.append(Voltages(first, values.astype(float)))
            del self._rest[:end]
        return blocks


_PATIENCE_S = 3.0
_WAIT_S = 0.02
_LONGEST_LINE = 200
_MOST_BYTES = 262_144


class SocketReader:
    """A client of one server.

    Parameters
    ----------
    device, clock, settings
        Of the driver.
    """

    def __init__(self, device: str, clock: Clock, settings: AtiDaqSettings) -> None:
        self._device = device
        self._clock = clock
        self._settings = settings
        self._where = f"{settings.server}:{settings.server_port}"
        self._connection: socket.socket | None = None
        self._parser = BlockParser()
        self._waiting: list[Voltages] = []
        self._next = 0
        self._card = Card("")

    def open(self) -> Card:
        """Connect; what it is comes with the start of a stream, so one is started and ended."""
        try:
            self._start(self._settings.rate_hz)
            return self._card
        finally:
            self.stop()

    def start(self, rate_hz: float) -> float:
        """Connect anew and begin: nothing of an earlier stream can come in between."""
        return self._start(rate_hz)

    def read(self) -> Voltages:
        """Return the next block, waiting a moment for it."""
        if not self._waiting and self._connection is not None:
            self._waiting = self._parser.feed(self._receive())
            if self._parser.broken:
                raise self._error(
                    "sends what are no blocks of voltages", "both programs must speak the same version"
                )
        if not self._waiting:
            return Voltages(self._next)
        block = self._waiting.pop(0)
        self._next = block.first + len(block.values)
        return block

    def stop(self) -> None:
        """Ask for the end, and hang up."""
        connection, self._connection = self._connection, None
        if connection is not None:
            with suppress(OSError):
                connection.sendall(b"stop\n")
            connection.close()

    def close(self) -> None:
        """Hang up."""
        self.stop()

    def _start(self, rate_hz: float) -> float:
        self.stop()
        self._parser, self._waiting, self._next = BlockParser(), [], 0
        try:
            address = (self._settings.server, self._settings.server_port)
            connection = self._connection = socket.create_connection(address, _PATIENCE_S)
            connection.sendall(f"start {rate_hz:.17g}\n".encode())
            line, rest = self._line(connection)
        except OSError as error:
            self.stop()
            reason = "no answer" if isinstance(error, TimeoutError) else error.strerror or str(error)
            raise self._error(
                f"cannot be reached: {reason}",
                "start the program that serves the voltages; see server and server_port",
            ) from None
        word, _, told = line.partition(" ")
        rate, _, told = told.partition(" ")
        try:
            true_hz = float(rate) if word == "voltages" else 0.0
        except ValueError:
            true_hz = 0.0
        if not 0.0 < true_hz <= 1e6:
            self.stop()
            raise self._error(
                f"answers {line[:40]!r} to start", "it should answer: voltages <rate> <model> <serial>"
            )
        model, _, serial = told.partition(" ")
        self._card = Card(model or "voltage server", serial)
        self._waiting = self._parser.feed(rest)
        connection.settimeout(_WAIT_S)
        return true_hz

    def _line(self, connection: socket.socket) -> tuple[str, bytes]:
        data = b""
        until_s = self._clock.now() + _PATIENCE_S
        while b"\n" not in data and len(data) <= _LONGEST_LINE and self._clock.now() < until_s:
            part = connection.recv(_MOST_BYTES)
            if not part:
                break
            data += part
        line, _, rest = data.partition(b"\n")
        text = line[:_LONGEST_LINE].decode("ascii", "replace")
        return "".join(letter if letter.isprintable() else "?" for letter in text), rest

    def _receive(self) -> bytes:
        assert self._connection is not None  # noqa: S101  asked by the caller
        try:
            data = self._connection.recv(_MOST_BYTES)
        except TimeoutError:
            return b""
        except OSError as error:
            raise self._error(
                f"broke the connection: {error.strerror}", "look at that program's own messages"
            ) from None
        if not data:
            raise self._error("has ended the connection", "start it again; look at its own messages")
        return data

    def _error(self, what: str, hint: str) -> DeviceError:
        return DeviceError(self._device, f"the voltage server at {self._where} {what}", hint=hint)
