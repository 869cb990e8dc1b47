"""The golden vectors: what each packet says, and its bytes; and a port in memory for the vendor's library."""

from dataclasses import dataclass, field
from typing import Any


def frame(text: str) -> bytes:
    return bytes.fromhex(text)


CLEAR = bytes([1, 0x44, 0x58, 0x4C, 0x22])

# name, id, instruction, parameters, bytes
INSTRUCTIONS = [
    ("ping", 1, 0x01, b"", "FF FF FD 00 01 03 00 01 19 4E"),
    ("ping everybody", 254, 0x01, b"", "FF FF FD 00 FE 03 00 01 31 42"),
    ("read 132", 1, 0x02, frame("84 00 04 00"), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    ("goal 512", 1, 0x03, frame("74 00 00 02 00 00"), "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
    ("reg write", 1, 0x04, frame("68 00 C8 00 00 00"), "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E"),
    ("action", 1, 0x05, b"", "FF FF FD 00 01 03 00 05 02 CE"),
    ("reboot", 1, 0x08, b"", "FF FF FD 00 01 03 00 08 2F 4E"),
    ("clear", 1, 0x10, CLEAR, "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC"),
    ("sync read", 254, 0x82, frame("84 00 04 00 01 02"), "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),
    (
        "sync write", 254, 0x83, frame("74 00 04 00 01 96 00 00 00 02 AA 00 00 00"),
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
    ),
    (
        "bulk read", 254, 0x92, frame("01 90 00 02 00 02 92 00 01 00"),
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
    ),
    (
        "bulk write", 254, 0x93, frame("01 20 00 02 00 A0 00 02 1F 00 01 00 50"),
        "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68",
    ),
    (
        "fast sync read", 254, 0x8A, frame("84 00 04 00 03 07 04"),
        "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2",
    ),
    (  # the manual prints 20 F2 for its check sum, which is that of the row above
        "fast bulk read", 254, 0x9A, frame("03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00"),
        "FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00 DA 2D",
    ),
    ("torque on", 1, 0x03, frame("40 00 01"), "FF FF FD 00 01 06 00 03 40 00 01 DB 66"),
    ("torque off, everybody", 254, 0x03, frame("40 00 00"), "FF FF FD 00 FE 06 00 03 40 00 00 2E 16"),
    (
        "torque off, sync", 254, 0x83, frame("40 00 01 00 01 00 02 00 03 00 04 00"),
        "FF FF FD 00 FE 0F 00 83 40 00 01 00 01 00 02 00 03 00 04 00 0E FE",
    ),
    ("watchdog 100 ms", 1, 0x03, frame("62 00 05"), "FF FF FD 00 01 06 00 03 62 00 05 68 E4"),
    ("watchdog clear", 1, 0x03, frame("62 00 00"), "FF FF FD 00 01 06 00 03 62 00 00 76 E4"),
    (
        "sync read of motion", 254, 0x82, frame("7E 00 0A 00 01 02 03 04"),
        "FF FF FD 00 FE 0B 00 82 7E 00 0A 00 01 02 03 04 02 4C",
    ),
    (
        "goal -131073, stuffed", 1, 0x03, frame("74 00 FF FF FD FF"),
        "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD FF 23 E5",
    ),
    ("goal current -100", 1, 0x03, frame("66 00 9C FF"), "FF FF FD 00 01 07 00 03 66 00 9C FF 40 6F"),
    ("read 70", 1, 0x02, frame("46 00 01 00"), "FF FF FD 00 01 07 00 02 46 00 01 00 3C A3"),
]  # fmt: skip

# name, id, error, data, bytes
STATUSES = [
    ("ping: 1030, firmware 38", 1, 0, frame("06 04 26"), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
    ("166", 1, 0, frame("A6 00 00 00"), "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
    ("written", 1, 0, b"", "FF FF FD 00 01 04 00 55 00 A1 0C"),
    ("id 2: 2079", 2, 0, frame("1F 08 00 00"), "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"),
    (
        "-50, -3, 2048", 1, 0, frame("CE FF FD FF FF FF 00 08 00 00"),
        "FF FF FD 00 01 0E 00 55 00 CE FF FD FF FF FF 00 08 00 00 30 3F",
    ),
    (
        "-1, -3, 2048, stuffed", 1, 0, frame("FF FF FD FF FF FF 00 08 00 00"),
        "FF FF FD 00 01 0F 00 55 00 FF FF FD FD FF FF FF 00 08 00 00 49 F0",
    ),
    ("alert", 1, 0x80, b"", "FF FF FD 00 01 04 00 55 80 A2 8F"),
    ("no access", 1, 7, b"", "FF FF FD 00 01 04 00 55 07 B0 8C"),
    ("out of range", 1, 4, b"", "FF FF FD 00 01 04 00 55 04 BA 8C"),
    ("overload", 1, 0x80, b"\x20", "FF FF FD 00 01 05 00 55 80 20 99 21"),
]  # fmt: skip

# name, blocks (id, error, data), bytes
FAST_STATUSES = [
    (
        "positions", [(3, 0, frame("A6 00 00 00")), (7, 0, frame("1F 08 00 00")), (4, 0, frame("FF 03 00 00"))],
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E",
    ),
    (
        "several kinds", [(3, 0, frame("A6 00 00 00")), (7, 0, frame("A5 01")), (4, 0, frame("1F"))],
        "FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4 00 07 A5 01 24 74 00 04 1F D9 C1",
    ),
]  # fmt: skip


@dataclass
class MemoryPort:
    """What the vendor's packet handler needs of a port: keeps what is sent, gives what was put in, in pieces."""

    answers: list[bytes] = field(default_factory=list)
    sent: list[bytes] = field(default_factory=list)
    is_using: bool = False

    def clearPort(self) -> None: ...

    def writePort(self, packet: Any) -> int:
        self.sent.append(bytes(packet))
        return len(packet)

    def readPort(self, _length: int) -> bytes:
        return self.answers.pop(0) if self.answers else b""

    def setPacketTimeout(self, _length: int) -> None: ...

    def isPacketTimeout(self) -> bool:
        return not self.answers
