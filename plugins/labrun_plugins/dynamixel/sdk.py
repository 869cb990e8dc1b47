"""dynamixel-sdk, hardened. Importing this imports the vendor's library.

What is put right here, of version 4.1.0: packets leave without byte stuffing; stuffing is not always taken back;
an answer that holds nothing but an error is returned as data; reading spins at full load on the wall clock; an
exception leaves the port marked as busy. The library still builds every instruction packet.
"""

# ruff: noqa: N802 - the names are the library's

from collections import deque
from collections.abc import Sequence
from typing import Any

from dynamixel_sdk import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS
from dynamixel_sdk.port_handler import PortHandler
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

from labrun.devices import Clock
from labrun.devices.serial_port import SerialPort
from labrun_plugins.dynamixel.codec import Status, StatusParser, stuff, unstuff

_INSTRUCTION = 7
_LENGTH_LOW, _LENGTH_HIGH = 5, 6


class HardenedPort(PortHandler):  # type: ignore[misc]
    """A port for the library: blocking reads, monotonic time, own patience.

    Parameters
    ----------
    patience_s
        How much longer than its time on the wire an answer may take.

    Attributes
    ----------
    sent_s
        When the last packet left.
    longest_gap_s
        The longest pause between two packets, since whoever asked last has set it to zero.
    """

    def __init__(self, serial: SerialPort, baud: int, clock: Clock, patience_s: float) -> None:
        self._serial = serial
        self._clock = clock
        self._patience_ms = 1e3 * patience_s
        self.sent_s = clock.now()
        self.longest_gap_s = 0.0
        super().__init__(serial.port)
        self.baudrate = baud
        self.tx_time_per_byte = 1e4 / baud
        self.is_open = True

    @property
    def is_using(self) -> bool:
        """Never busy: who may talk is decided by the bus, and a failure must not lock it for good."""
        return False

    @is_using.setter
    def is_using(self, _busy: bool) -> None:
        pass

    def clearPort(self) -> None:
        """Do nothing: the bus drops stale bytes before a question; a command must not drop another thread's answer."""

    def readPort(self, length: int) -> bytes:
        """Return what has arrived; waits a moment for the first byte."""
        return self._serial.read(max(1, length))

    def writePort(self, packet: Sequence[int]) -> int:
        """Send a packet; return its length."""
        self.longest_gap_s = max(self.longest_gap_s, self._clock.now() - self.sent_s)
        self._serial.write(bytes(packet))
        self.sent_s = self._clock.now()
        return len(packet)

    def setPacketTimeout(self, packet_length: int) -> None:
        """Expect an answer of so many bytes from now on."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + self._patience_ms)

    def getCurrentTime(self) -> float:
        """Return monotonic time, ms."""
        return 1e3 * self._clock.now()


class HardenedHandler(Protocol2PacketHandler):  # type: ignore[misc]
    """The library's packets, with stuffing both ways and answers that are what they should be.

    Attributes
    ----------
    parser
        Finds the answers; counts what was damaged.
    strangers
        Ids that answered without having been asked.
    """

    def __init__(self) -> None:
        super().__init__()
        self.parser = StatusParser()
        self.strangers: set[int] = set()
        self._ready: deque[Status] = deque()

    @property
    def noise(self) -> int:
        """Frames and bytes that arrived and were no answer, so far."""
        return self.parser.damaged + self.parser.skipped + (self.parser.pending > 0)

    def forget(self) -> None:
        """Drop what arrived before a question."""
        self.parser.clear()
        self._ready.clear()

    def addStuffing(self, packet: list[int]) -> list[int]:
        """Stuff a packet in place: its caller looks at nothing else."""
        end = _INSTRUCTION + packet[_LENGTH_LOW] + 256 * packet[_LENGTH_HIGH] - 2
        body = stuff(bytes(packet[_INSTRUCTION:end]))
        packet[_INSTRUCTION:] = [*body, 0, 0]
        self._set_length(packet, len(body) + 2)
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:
        """Take stuffing back in place."""
        end = _INSTRUCTION + packet[_LENGTH_LOW] + 256 * packet[_LENGTH_HIGH] - 2
        body = unstuff(bytes(packet[_INSTRUCTION:end]))
        packet[_INSTRUCTION:end] = body
        self._set_length(packet, len(body) + 2)
        return packet

    def status(self, port: Any) -> Status | None:
        """Return the next status packet; None if none came in time."""
        while not self._ready:
            self._ready.extend(self.parser.feed(port.readPort(256)))
            if not self._ready and port.isPacketTimeout():
                return None
        return self._ready.popleft()

    def rxPacket(self, port: Any, fast_option: bool) -> tuple[list[int], int]:
        """Return the next status packet as the library lays it out, stuffing taken back, and whether it is one."""
        damaged = self.parser.damaged
        status = self.status(port)
        if status is None:
            torn = self.parser.pending or self.parser.damaged > damaged
            return [], int(COMM_RX_CORRUPT if torn else COMM_RX_TIMEOUT)
        packet = list(status.raw)
        return (packet if fast_option else self.removeStuffing(packet)), int(COMM_SUCCESS)

    def answer(self, port: Any, dxl_id: int, length: int) -> Status | None:
        """Return this servo's answer with so many bytes of data, or its refusal; None if neither came in time.

        An answer of another length that complains of nothing is the late one to an earlier question.
        """
        while (status := self.status(port)) is not None:
            if status.id == dxl_id and (len(status.data) == length or (not status.data and status.refusal)):
                return status
            if status.id != dxl_id:
                self.strangers.add(status.id)
        return None

    def readTxRx(self, port: Any, dxl_id: int, address: int, length: int) -> tuple[list[int], int, int]:
        """Read; a refusal carries no data, and is not taken for some."""
        self.readTx(port, dxl_id, address, length)
        return self.readRx(port, dxl_id, length)

    def readRx(self, port: Any, dxl_id: int, length: int) -> tuple[list[int], int, int]:
        """Take the answer to a read."""
        status = self.answer(port, dxl_id, length)
        if status is None:
            return [], int(COMM_RX_CORRUPT if self.parser.pending else COMM_RX_TIMEOUT), 0
        whole = len(status.data) == length
        return list(status.data), int(COMM_SUCCESS if whole else COMM_RX_CORRUPT), status.error

    @staticmethod
    def _set_length(packet: list[int], length: int) -> None:
        packet[_LENGTH_LOW], packet[_LENGTH_HIGH] = length & 0xFF, length >> 8
