"""Modbus RTU over a port the driver holds: pymodbus makes the requests and checks the answers."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from labrun.devices import Clock, DeviceError, SerialPort

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
    device
        Its name in the experiment file.
    port
        Open, and read by nobody else during a request.
    clock
        For time-outs.
    slave_id
        Whose registers.
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
        return None, f"answered with {len(heard)} bytes that are no answer" if heard else "does not answer"

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
