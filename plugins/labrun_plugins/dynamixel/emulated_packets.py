"""Protocol 2.0 as a servo sees it: instruction packets in, status packets out.

Source: ROBOTIS e-Manual, Protocol 2.0. Shares no code with the host's side, so that a misreading shows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

PING, READ, WRITE, REG_WRITE, ACTION, FACTORY_RESET = 1, 2, 3, 4, 5, 6
REBOOT, CLEAR, BACKUP = 8, 0x10, 0x20
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A
EVERYBODY = 0xFE

_MARK = (0xFF, 0xFF, 0xFD)
_MOST = 1024


def checksum(data: bytes) -> int:
    """Return the remainder of division by x^16 + x^15 + x^2 + 1, first bit first, from zero."""
    remainder = 0
    for byte in data:
        remainder ^= byte << 8
        for _ in range(8):
            remainder <<= 1
            if remainder > 0xFFFF:
                remainder ^= 0x18005
    return remainder


def _with_stuffing(body: Sequence[int]) -> list[int]:
    sent: list[int] = []
    for byte in body:
        sent.append(byte)
        if tuple(sent[-3:]) == _MARK:
            sent.append(0xFD)
    return sent


def _without_stuffing(body: Sequence[int]) -> list[int]:
    kept: list[int] = []
    skip = False
    for index, byte in enumerate(body):
        if skip:
            skip = False
            continue
        kept.append(byte)
        skip = tuple(body[max(0, index - 2) : index + 1]) == _MARK and body[index + 1 : index + 2] == [0xFD]
    return kept


def _framed(identity: int, body: Sequence[int]) -> bytes:
    length = len(body) + 2
    frame = bytes([*_MARK, 0, identity, length % 256, length // 256, *body])
    return frame + checksum(frame).to_bytes(2, "little")


def status_packet(identity: int, error: int, data: bytes = b"") -> bytes:
    """Return a servo's answer."""
    return _framed(identity, _with_stuffing([0x55, error, *data]))


def instruction_packet(identity: int, code: int, parameters: bytes = b"") -> bytes:
    """Return what a host would send."""
    return _framed(identity, _with_stuffing([code, *parameters]))


def fast_status_packet(blocks: Sequence[tuple[int, int, bytes]]) -> bytes:
    """Return the joint answer to a fast read, of (id, error, data) of each servo; it is not stuffed.

    After each block stands the check sum of the packet up to there.
    """
    length = 1 + sum(len(data) + 4 for _, _, data in blocks)
    packet = bytes([*_MARK, 0, EVERYBODY, length % 256, length // 256, 0x55])
    for identity, error, data in blocks:
        packet += bytes([error, identity]) + data
        packet += checksum(packet).to_bytes(2, "little")
    return packet


@dataclass(frozen=True, slots=True)
class Instruction:
    """One instruction packet; `sound` tells whether its check sum holds."""

    id: int
    code: int
    parameters: bytes
    sound: bool = True


class InstructionReader:
    """Takes bytes off the bus, one at a time as a servo does."""

    def __init__(self) -> None:
        self._packet: list[int] = []

    def feed(self, data: bytes) -> list[Instruction]:
        """Return the instructions that are whole now."""
        writes = []
        for byte in data:
            self._packet.append(byte)
            if whole := self._whole():
                if (instruction := self._instruction(whole)) is not None:
                    writes.append(instruction)
            else:
                self._realign()
        return writes

    def _realign(self) -> None:
        """Begin again at a header: unstuffed it can stand nowhere else."""
        packet = self._packet
        if len(packet) > 4 and packet[-4:] == [*_MARK, 0]:
            self._packet = packet[-4:]
            return
        for index, wanted in enumerate((*_MARK, 0)):
            if index < len(packet) <= 4 and packet[index] != wanted:
                # FF FF FF FD: the first of three may have been noise
                self._packet = (
                    packet[1:] if packet == [0xFF, 0xFF, 0xFF] else ([0xFF] if packet[-1] == 0xFF else [])
                )
                return

    def _whole(self) -> int:
        packet = self._packet
        if len(packet) < 7:
            return 0
        length = packet[5] + 256 * packet[6]
        if not 3 <= length <= _MOST:
            self._packet = []
            return 0
        return 7 + length if len(packet) == 7 + length else 0

    def _instruction(self, whole: int) -> Instruction | None:
        packet, self._packet = self._packet[:whole], []
        if packet[7] == 0x55:
            return None  # another servo's answer
        sound = checksum(bytes(packet[:-2])) == packet[-2] + 256 * packet[-1]
        body = _without_stuffing(packet[7:-2])
        return Instruction(packet[4], body[0], bytes(body[1:]), sound)
