"""The serial line of one FT300: its registers by Modbus RTU, getting its attention, switching its stream."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from labrun.devices import Clock, DeviceError, SerialPort
from labrun_plugins.robotiq_ft300 import codec

if TYPE_CHECKING:
    from pymodbus.framer import FramerRTU
    from pymodbus.pdu import ModbusPDU

_EXCEPTION_BYTES = 5
_WRITTEN_BYTES = 8
_MOST_KEPT = 512
_MEANING = {
    1: "it does not know this function",
    2: "it has no such register",
    3: "it does not take this value",
    4: "it failed to carry this out",
    6: "it is busy",
}


class Registers:
    """Reads and writes registers of one slave.

    A port of pymodbus' own would have to be closed and opened again around every stream; with the framer alone, the
    driver holds one port all the time, and nobody else can take it in between.

    Parameters
    ----------
    port
        Open, and read by nobody else during a request.
    answer_s
        How long an answer may take, s.
    tries
        How often a request to read is sent before its failure is raised.

    Raises
    ------
    DeviceError
        pymodbus is not installed; or, from `read` and `write`: no answer, a damaged one, or an exception code.
    """

    def __init__(
        self,
        device: str,
        port: SerialPort,
        clock: Clock,
        slave_id: int,
        *,
        answer_s: float = 0.25,
        tries: int = 2,
    ) -> None:
        self._device = device
        self._port = port
        self._clock = clock
        self._slave_id = slave_id
        self._answer_s = answer_s
        self._tries = tries
        self._framer = _framer(device)
        self._owed = False

    def read(self, address: int, count: int) -> tuple[int, ...]:
        """Return `count` registers from `address` on, each 0 ... 65535 (function 03)."""
        from pymodbus.pdu.register_message import ReadHoldingRegistersRequest

        request = ReadHoldingRegistersRequest(address=address, count=count, dev_id=self._slave_id)
        answer = self._ask(request, 5 + 2 * count, f"read register {address}", self._tries)
        return tuple(int(register) for register in answer.registers)

    def write(self, address: int, values: Sequence[int]) -> None:
        """Set registers from `address` on, asking once (function 16, the one the vendor's driver uses)."""
        from pymodbus.pdu.register_message import WriteMultipleRegistersRequest

        request = WriteMultipleRegistersRequest(
            address=address, count=len(values), registers=list(values), dev_id=self._slave_id
        )
        self._ask(request, _WRITTEN_BYTES, f"write register {address}", 1)

    def _ask(self, request: "ModbusPDU", answer_bytes: int, what: str, tries: int) -> "ModbusPDU":
        frame = self._framer.buildFrame(request)
        trouble = ""
        for _ in range(tries):
            self._settle()
            self._port.write(frame)
            answer, trouble = self._hear(request, answer_bytes)
            if answer is None:
                continue
            if answer.isError():
                code = int(getattr(answer, "exception_code", 0))
                raise DeviceError(
                    self._device,
                    f"refused to {what}: Modbus exception {code:02d}, {_MEANING.get(code, 'no known code')}",
                    hint="an FT300 has this register: check that this port leads to one, and its firmware",
                )
            return answer
        raise DeviceError(
            self._device,
            f"{trouble} (asked {_times(tries)} to {what}, slave {self._slave_id}, {self._port.port})",
            hint="check its 24 V supply, its cable (RS-485 A and B swapped?), and baud and slave_id of its table",
        )

    def _settle(self) -> None:
        """Clear the line: an answer that comes late must not pass for the one to the next request."""
        if self._owed:
            until_s = self._clock.now() + self._answer_s
            while self._clock.now() < until_s:
                self._port.read()
        self._port.discard_input()

    def _hear(self, request: "ModbusPDU", answer_bytes: int) -> tuple["ModbusPDU | None", str]:
        """Return the answer, or none and what was wrong."""
        heard = bytearray()
        deadline_s = self._clock.now() + self._answer_s
        damaged = False
        while True:
            heard += self._port.read()
            answer, bad = self._find(bytes(heard), request.function_code, answer_bytes)
            damaged = damaged or bad
            if answer is not None:
                self._owed = False
                return answer, ""
            if self._clock.now() >= deadline_s:
                break
            del heard[:-_MOST_KEPT]
        self._owed = not heard
        if damaged:
            return None, "answered with a wrong checksum"
        return (
            None,
            f"answered with {len(heard)} bytes that are not an answer" if heard else "does not answer",
        )

    def _find(self, heard: bytes, function: int, answer_bytes: int) -> "tuple[ModbusPDU | None, bool]":
        """Look for the answer anywhere in what came; tell also whether one with a wrong checksum is there."""
        damaged = False
        for at in range(len(heard) - _EXCEPTION_BYTES + 1):
            if heard[at] != self._slave_id or heard[at + 1] & 0x7F != function:
                continue
            size = _EXCEPTION_BYTES if heard[at + 1] & 0x80 else answer_bytes
            if len(heard) - at < size:
                continue
            if heard[at + 1] == 3 and heard[at + 2] != answer_bytes - 5:
                continue  # the answer to another request
            answer = self._decoded(heard[at : at + size])
            if answer is not None:
                return answer, False
            damaged = True
        return None, damaged

    def _decoded(self, frame: bytes) -> "ModbusPDU | None":
        from pymodbus.exceptions import ModbusException

        try:
            return self._framer.handleFrame(frame, self._slave_id, 0)[1]
        except ModbusException:
            return None


def _times(tries: int) -> str:
    return "once" if tries == 1 else f"{tries} times"


def _framer(device: str) -> "FramerRTU":
    try:
        from pymodbus.framer import FramerRTU
        from pymodbus.pdu import DecodePDU
    except ImportError as error:
        raise DeviceError(
            device, "its driver needs pymodbus, which is not installed", hint="pip install 'labrun[robotiq]'"
        ) from error
    return FramerRTU(DecodePDU(is_server=False))


_LISTEN_S = 0.05
"""Five frames of a stream; an adapter with a latency timer of 16 ms hands over something in that time, too."""
_REST_S = 0.15
"""After a jam it needs at least 100 ms."""
_JAMS = 4
_STARTS = 3


@dataclass(frozen=True, slots=True)
class Nameplate:
    """What the sensor says of itself."""

    firmware: str
    serial: str
    year: int


class Link:
    """What can be asked of a sensor that does not stream, and how to make it stream or stop.

    Parameters
    ----------
    answer_s, tries
        As of `Registers`.
    """

    def __init__(
        self,
        device: str,
        port: SerialPort,
        clock: Clock,
        slave_id: int,
        *,
        answer_s: float = 0.25,
        tries: int = 2,
    ) -> None:
        self._device = device
        self._port = port
        self._clock = clock
        self.registers = Registers(device, port, clock, slave_id, answer_s=answer_s, tries=tries)

    def wake(self) -> int:
        """Make sure that it listens: it may still stream from a run before. Returns how many jams it took.

        Raises DeviceError: something on this port goes on sending.
        """
        parser = codec.StreamParser()
        for jams in range(_JAMS):
            heard = self._hear(_LISTEN_S)
            if not heard:
                return jams
            parser.feed(heard)
            self.jam()
        if not (heard := self._hear(_LISTEN_S)):
            return _JAMS
        parser.feed(heard)
        if parser.frames:
            raise DeviceError(
                self._device,
                f"keeps streaming after {_JAMS} x {len(codec.JAM)} bytes FF, which should stop it",
                hint="does the line lead to the sensor (A and B, both directions)? switch its supply off and on",
            )
        raise DeviceError(
            self._device,
            f"{self._port.port} sends bytes that are not frames of an FT300",
            hint="check that this port leads to the sensor, and the baud of its table",
        )

    def jam(self) -> None:
        """End the stream, wait until the sensor listens again, and throw away what came meanwhile."""
        self._port.write(codec.JAM)
        self._clock.sleep(_REST_S)
        self._port.discard_input()

    def nameplate(self) -> Nameplate:
        """Ask what it is. Raises DeviceError: no answer, or something answers that is no force/torque sensor."""
        firmware = self.firmware()
        serial = codec.serial_text(self.registers.read(codec.SERIAL, 4))
        (year,) = self.registers.read(codec.YEAR, 1)
        return Nameplate(firmware, serial, year)

    def firmware(self) -> str:
        """Ask for its firmware; DeviceError if it is not that of a force/torque sensor."""
        firmware = codec.firmware_text(self.registers.read(codec.FIRMWARE, 3))
        if not codec.is_sensor(firmware):
            raise DeviceError(
                self._device,
                f"the device that answers is not an FT300: its firmware is {firmware}, one of the sensor begins with F",
                hint="a gripper of Robotiq speaks Modbus with slave 9, too: check port and cable",
            )
        return firmware

    def start_stream(self) -> None:
        """Switch the stream on; from now on it answers nothing.

        Raises DeviceError: it does not stream, whatever it answered.
        """
        for attempt in range(_STARTS):
            try:
                self.registers.write(codec.SELECT_OUTPUT, [codec.STREAM_ON])
                return
            except DeviceError:
                if self.streams():  # only its acknowledgement got lost
                    return
                if attempt == _STARTS - 1:
                    raise

    def streams(self) -> bool | None:
        """Listen whether it streams; None if something else talks here."""
        heard = self._hear(_LISTEN_S)
        if not heard:
            return False
        parser = codec.StreamParser()
        return True if parser.feed(heard) else None

    def _hear(self, duration_s: float) -> bytes:
        heard = b""
        until_s = self._clock.now() + duration_s
        while self._clock.now() < until_s:
            heard += self._port.read()
        return heard
