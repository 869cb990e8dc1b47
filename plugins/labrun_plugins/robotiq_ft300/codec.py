"""Bytes and registers of an FT300, and the values they stand for. Nothing here touches a port.

Layout and scales: FT 300 and FT 300-S instruction manuals, section "Serial communication".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from labrun.devices import FloatArray

WRENCH, SELECT_OUTPUT, FIRMWARE, SERIAL, YEAR = 180, 410, 500, 510, 514
"""First register of the wrench (6), of the output select (1), firmware (3), serial (4) and year (1)."""
STREAM_ON = 0x0200
JAM = b"\xff" * 50
"""What makes it leave its stream: it listens for nothing else then."""
HEADER = b"\x20\x4e"
FRAME_BYTES = 16
STREAM_HZ = 100.0

_STEP = np.array([0.01, 0.01, 0.01, 0.001, 0.001, 0.001])
"""N and N m of one count."""
FULL_SCALE_COUNTS = 30_000
"""300 N, and 30 N m."""


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
        table.append(crc)
    return tuple(table)


_CRC_TABLE = _crc_table()


def crc16(data: bytes) -> int:
    """Return the CRC of Modbus (polynomial A001 reflected, from FFFF); sent low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


def wrench(counts: Sequence[Sequence[int]]) -> FloatArray:
    """Return forces (N) and torques (N m), shape (n, 6), of signed counts, without any offset taken off."""
    return np.asarray(np.asarray(counts, dtype=float).reshape(-1, 6) * _STEP)


def saturated(counts: Sequence[Sequence[int]]) -> int:
    """Return how many of these samples stand at the end of the range in at least one axis."""
    return sum(any(abs(count) >= FULL_SCALE_COUNTS for count in row) for row in counts)


def signed(registers: Sequence[int]) -> tuple[int, ...]:
    """Return registers (0 ... 65535) as signed numbers."""
    return tuple(register - 0x10000 if register & 0x8000 else register for register in registers)


def _letter(byte: int) -> str:
    return chr(byte) if 0x21 <= byte <= 0x7E else "?"


def firmware_text(registers: Sequence[int]) -> str:
    """Return registers 500-502 as text, for example ``FTS-1.2.3``; what is no letter is shown as ``?``."""
    first, second, third = registers
    letters = _letter(first >> 8) + _letter(first & 0xFF) + _letter(second >> 8)
    return f"{letters}-{second & 0xFF}.{third >> 8}.{third & 0xFF}"


def serial_text(registers: Sequence[int]) -> str:
    """Return registers 510-513 as text, for example ``FTS-0042``."""
    first, second, low, high = registers
    letters = _letter(first >> 8) + _letter(first & 0xFF) + _letter(second >> 8)
    return f"{letters}-{(high << 16) + low:04d}"


def is_sensor(firmware: str) -> bool:
    """Tell whether this firmware is that of a force/torque sensor: the vendor's driver knows it by its first letter."""
    return firmware.startswith("F")


class Frame(NamedTuple):
    """One frame of the stream."""

    counts: tuple[int, ...]
    """Fx, Fy, Fz in 0.01 N, Mx, My, Mz in 0.001 N m."""
    later_bytes: int
    """How many bytes had come after its last one when it was found."""


def stream_frame(counts: Sequence[int]) -> bytes:
    """Return the frame the sensor sends for these six counts."""
    body = HEADER + b"".join(count.to_bytes(2, "little", signed=True) for count in counts)
    return body + crc16(body).to_bytes(2, "little")


@dataclass
class StreamParser:
    """Finds frames in a stream of bytes, whatever they are and however they come.

    The header also occurs within frames (a force of 200.00 N is ``20 4E``), so that a header counts only together
    with the checksum 14 bytes on; if that is wrong, the search goes on one byte further, not one frame.

    Attributes
    ----------
    frames, crc_errors, skipped_bytes
        What was found so far: good frames, headers whose checksum was wrong, and bytes that belong to no frame.
    """

    frames: int = 0
    crc_errors: int = 0
    skipped_bytes: int = 0

    def __post_init__(self) -> None:
        self._kept = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Take what has arrived; return the frames it completes. Keeps less than a frame for the next time."""
        self._kept += data
        kept = self._kept
        frames: list[Frame] = []
        at = 0
        while len(kept) - at >= FRAME_BYTES:
            header = kept.find(HEADER, at)
            if header < 0:
                header = len(kept) - 1  # its last byte may be the first one of a header
            self.skipped_bytes += header - at
            at = header
            if len(kept) - at < FRAME_BYTES:
                break
            body = bytes(kept[at : at + FRAME_BYTES])
            if crc16(body[:-2]) != int.from_bytes(body[-2:], "little"):
                self.crc_errors += 1
                self.skipped_bytes += 1
                at += 1
                continue
            at += FRAME_BYTES
            counts = tuple(int.from_bytes(body[i : i + 2], "little", signed=True) for i in range(2, 14, 2))
            frames.append(Frame(counts, len(kept) - at))
        del kept[:at]
        self.frames += len(frames)
        return frames
