"""What gives six voltages: the only part of the driver that knows which card it is.

Over TCP, for cards that NI-DAQmx does not drive: the client sends lines, ``start <rate>`` and ``stop``. The server
answers the first with one line, ``voltages <rate> <model> <serial>``, and then sends blocks until ``stop`` or the end
of the connection. A block is ``LRV1 | count u32 | first u64 | count x 6 x f64``, all big-endian: how many samples, the
number of the first one since the start, and the voltages of gauge 1 to 6 of each.
"""

import socket
import struct
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labrun.devices import Clock, DeviceError, FloatArray
from labrun_plugins.ati_daq.settings import GAUGES, AtiDaqSettings


@dataclass(frozen=True, slots=True)
class Voltages:
    """A block of samples.

    Attributes
    ----------
    first
        Number of its first sample since the start, by the card's own count: a gap is a loss.
    values : (n, 6)
        V.
    """

    first: int
    values: FloatArray = field(default_factory=lambda: np.empty((0, GAUGES)))


@dataclass(frozen=True, slots=True)
class Card:
    """What the voltages come from."""

    model: str
    serial: str = ""
    firmware: str = ""


_BUFFER_S = 4.0
_NAP_S = 0.005
_OVERWRITTEN = -200279
_GONE = (-88705, -201003, -200220)
_NO_CHANNEL = (-200170, -200220)


class NidaqmxReader:
    """Six analogue inputs with a hardware clock."""

    def __init__(self, device: str, clock: Clock, settings: AtiDaqSettings) -> None:
        self._device = device
        self._clock = clock
        self._settings = settings
        self._task: Any = None
        self._reader: Any = None
        self._next = 0

    def open(self) -> Card:
        """Reserve the inputs."""
        try:
            import nidaqmx
            from nidaqmx.constants import TerminalConfiguration
            from nidaqmx.stream_readers import AnalogMultiChannelReader
        except ImportError:
            raise DeviceError(
                self._device, 'reader = "nidaqmx" needs the library nidaqmx', hint="pip install 'labrun[daq]'"
            ) from None
        wiring = (
            TerminalConfiguration.DIFF
            if self._settings.wiring == "differential"
            else TerminalConfiguration.RSE
        )
        try:
            self._task = nidaqmx.Task()
            self._task.ai_channels.add_ai_voltage_chan(
                self._settings.input,
                terminal_config=wiring,
                min_val=-self._settings.range_v,
                max_val=self._settings.range_v,
            )
            count = len(self._task.ai_channels)
            card = self._task.devices[0] if count else None
            answer = Card(str(card.product_type), f"{card.serial_num:X}") if card is not None else Card("")
            self._reader = AnalogMultiChannelReader(self._task.in_stream)
        except Exception as error:
            self.close()
            raise self._explained(error, nidaqmx) from None
        if count != GAUGES:
            self.close()
            raise DeviceError(
                self._device,
                f"input = {self._settings.input!r} is {count} channels, and the sensor has {GAUGES} gauges",
                hint='for example input = "Dev1/ai0:5"',
            )
        return answer

    def start(self, rate_hz: float) -> float:
        """Begin to sample; return the true rate, Hz."""
        import nidaqmx
        from nidaqmx.constants import AcquisitionType

        try:
            self._task.timing.cfg_samp_clk_timing(
                rate_hz,
                sample_mode=AcquisitionType.CONTINUOUS,
                samps_per_chan=max(1000, int(_BUFFER_S * rate_hz)),
            )
            self._next = 0
            self._task.start()
            return float(self._task.timing.samp_clk_rate)
        except Exception as error:
            raise self._explained(error, nidaqmx) from None

    def read(self) -> Voltages:
        """Return what the card has put into its buffer."""
        import nidaqmx

        try:
            count = int(self._task.in_stream.avail_samp_per_chan)
            if count == 0:
                self._clock.sleep(_NAP_S)
                return Voltages(self._next)
            values = np.empty((GAUGES, count))
            self._reader.read_many_sample(values, number_of_samples_per_channel=count, timeout=0.0)
        except Exception as error:
            raise self._explained(error, nidaqmx) from None
        first, self._next = self._next, self._next + count
        return Voltages(first, np.ascontiguousarray(values.T))

    def stop(self) -> None:
        """End sampling."""
        if self._task is not None:
            with suppress(Exception):  # it is over, whatever a card that was unplugged says to that
                self._task.stop()

    def close(self) -> None:
        """Give the inputs back."""
        task, self._task, self._reader = self._task, None, None
        if task is not None:
            with suppress(Exception):
                task.close()

    def _explained(self, error: Exception, nidaqmx: Any) -> DeviceError:
        if isinstance(error, nidaqmx.errors.DaqNotFoundError):
            return DeviceError(
                self._device,
                "the NI-DAQmx driver is not installed (nidaqmx is only its Python face)",
                hint='install it from ni.com/downloads; or serve another card with reader = "socket"',
            )
        code = getattr(error, "error_code", 0)
        text = " ".join(str(error).split())[:200]
        if code == _OVERWRITTEN:
            hint = "this computer was too busy to fetch the samples in time: lower rate_hz"
        elif code in _GONE or code in _NO_CHANNEL:
            hint = f"is the card plugged in? `input` is {self._settings.input!r}; NI MAX lists the cards"
        else:
            hint = f"NI-DAQmx error {code}; NI MAX can test the card"
        return DeviceError(self._device, f"the card says: {text}", hint=hint)


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
    """A client of one server."""

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
            self.start(self._settings.rate_hz)
            return self._card
        finally:
            self.stop()

    def read(self) -> Voltages:
        """Return the next block, waiting a moment for it."""
        if not self._waiting and self._connection is not None:
            self._waiting = self._parser.feed(self._receive())
            if self._parser.broken:
                raise self._error(
                    "sends data that are not blocks of voltages", "both programs must speak the same version"
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

    def start(self, rate_hz: float) -> float:
        """Connect anew, so that nothing of an earlier stream comes in between, and begin; return the true rate, Hz."""
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
        word, _, argument = line.partition(" ")
        rate, _, argument = argument.partition(" ")
        try:
            true_hz = float(rate) if word == "voltages" else 0.0
        except ValueError:
            true_hz = 0.0
        if not 0.0 < true_hz <= 1e6:
            self.stop()
            raise self._error(
                f"answers {line[:40]!r} to start", "it should answer: voltages <rate> <model> <serial>"
            )
        model, _, serial = argument.partition(" ")
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


VoltageReader = NidaqmxReader | SocketReader
"""Reads six voltages at a steady rate. All of its errors are DeviceErrors that name the device."""
