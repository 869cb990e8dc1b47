"""Protocol 2.0 as the host sees it: check sum, byte stuffing, and a parser of status packets.

Source: ROBOTIS e-Manual, Protocol 2.0. Nothing here does input or output.
"""

from collections.abc import Sequence
from dataclasses import dataclass

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
STATUS = 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
ALERT = 0x80
_POLYNOMIAL = 0x8005
_LEAST_LENGTH = 3
_MOST_LENGTH = 1_024
_PREFIX = 7
"""Header, id and length: what comes before the counted bytes."""


def _table() -> tuple[int, ...]:
    rows = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ _POLYNOMIAL if crc & 0x8000 else crc << 1
        rows.append(crc & 0xFFFF)
    return tuple(rows)


CRC_TABLE = _table()


def crc16(data: bytes) -> int:
    """Return the check sum of a packet from its first header byte on: CRC-16/BUYPASS."""
    crc = 0
    for byte in data:
        crc = ((crc << 8) ^ CRC_TABLE[(crc >> 8) ^ byte]) & 0xFFFF
    return crc


def stuff(body: bytes) -> bytes:
    """Return instruction and parameters with every FF FF FD followed by one more FD."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """Take back what `stuff` did."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def instruction(identity: int, code: int, parameters: bytes) -> bytes:
    """Return an instruction packet."""
    body = stuff(bytes([code]) + parameters)
    packet = HEADER + bytes([identity]) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


@dataclass(frozen=True, slots=True)
class Status:
    """One status packet.

    Attributes
    ----------
    id
        Of the servo that answers; `BROADCAST` for the joint answer to a fast read.
    error
        Its error byte: bit 7 is Alert, the rest a number.
    data
        Its parameters; those of a fast answer begin after the error byte of the first block.
    raw
        The whole packet as it came over the wire.
    """

    id: int
    error: int
    data: bytes
    raw: bytes

    @property
    def alert(self) -> bool:
        """Tell whether the servo has latched a hardware error."""
        return bool(self.error & ALERT)

    @property
    def refusal(self) -> int:
        """The error number; 0 for none."""
        return self.error & ~ALERT


class StatusParser:
    """Finds status packets in what arrives, in whatever pieces.

    Attributes
    ----------
    damaged
        Frames whose check sum did not hold, or that never became whole.
    skipped
        Bytes that belonged to no frame.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.damaged = 0
        self.skipped = 0

    @property
    def pending(self) -> int:
        """Bytes of a packet that is not yet whole."""
        return len(self._buffer)

    def clear(self) -> None:
        """Forget what has arrived; the counters stay. A packet that never became whole is a damaged one."""
        if len(self._buffer) > len(HEADER):
            self.damaged += 1
        self._buffer.clear()

    def feed(self, data: bytes) -> list[Status]:
        """Return the packets that are whole now."""
        self._buffer += data
        statuses: list[Status] = []
        while True:
            start = self._buffer.find(HEADER)
            if start < 0:
                self._skip(self._harmless_prefix())
                return statuses
            self._skip(start)
            if len(self._buffer) < _PREFIX:
                return statuses
            length = int.from_bytes(self._buffer[5:7], "little")
            identity = self._buffer[4]
            if not _LEAST_LENGTH <= length <= _MOST_LENGTH or identity in (0xFD, 0xFF):
                self._skip(1)
                continue
            if len(self._buffer) == _PREFIX:
                return statuses
            answer = self._buffer[_PREFIX] == STATUS
            stuffed = not (answer and identity == BROADCAST)
            whole = _PREFIX + length
            # A damaged length may promise more than ever comes: in what is stuffed, another header inside is the true
            # one. The last three bytes may look like one, if check sum and body happen to fit.
            inner = self._buffer.find(HEADER, 1, whole - 1) if stuffed else -1
            if inner > 0:
                self.damaged += 1
                del self._buffer[:inner]
                continue
            if len(self._buffer) < whole:
                return statuses
            raw = bytes(self._buffer[:whole])
            short = answer and length == _LEAST_LENGTH  # no room for an error byte: no servo says that
            if short or crc16(raw[:-2]) != int.from_bytes(raw[-2:], "little"):
                self.damaged += 1
                del self._buffer[:1]
                continue
            del self._buffer[:whole]
            if answer:  # else an instruction: the echo of our own words
                body = unstuff(raw[8:-2]) if stuffed else raw[8:-2]
                statuses.append(Status(identity, body[0], body[1:], raw))

    def _harmless_prefix(self) -> int:
        """Return how many bytes cannot be part of a header that is still arriving."""
        for kept in (3, 2, 1):
            if self._buffer.endswith(HEADER[:kept]):
                return len(self._buffer) - kept
        return len(self._buffer)

    def _skip(self, count: int) -> None:
        if count:
            self.skipped += count
            del self._buffer[:count]


def split_fast(status: Status, ids: Sequence[int], length: int) -> dict[int, Status] | None:
    """Take apart the joint answer to a fast sync read.

    Each block is error, id, data and the check sum of everything up to there; blocks come in the order of the request.

    Returns
    -------
    dict or None
        Id -> its own status; None if the packet is not the answer to this request.
    """
    block = length + 4
    body = status.raw[8:]
    if status.id != BROADCAST or len(body) != block * len(ids):
        return None
    statuses: dict[int, Status] = {}
    for number, wanted in enumerate(ids):
        part = body[number * block : (number + 1) * block]
        end = 8 + (number + 1) * block
        if part[1] != wanted or crc16(status.raw[: end - 2]) != int.from_bytes(part[-2:], "little"):
            return None
        statuses[wanted] = Status(wanted, part[0], part[2:-2], part)
    return statuses
