"""The host's side of the wire: values to lines, and bytes to lines."""

import binascii
from dataclasses import dataclass

MAX_LINE_BYTES = 96
"""Longest line, from ``$`` to the newline, both included."""
LAST_SEQ = 65_535
UNSOLICITED = 0
"""Sequence number of lines that a device sends unasked: events and samples."""

_CRC_START = 0xFFFF
_CRC_DIGITS = b"0123456789ABCDEF"
_CRC_BYTES = 4


@dataclass(frozen=True, slots=True)
class Line:
    """One line whose checksum was right.

    Attributes
    ----------
    seq
        1 ... 65535 repeats the number of a request; 0 marks a line sent unasked.
    fields
        Word and arguments; never empty. Printable ASCII without ``$``, ``*`` and comma.
    """

    seq: int
    fields: tuple[str, ...]

    @property
    def word(self) -> str:
        """The first field: ``OK``, ``ERR``, ``EV``, ``S``, or a request's word."""
        return self.fields[0]


def checksum(body: bytes) -> int:
    """Return CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, nothing reflected): 0x29B1 for b"123456789"."""
    return binascii.crc_hqx(body, _CRC_START)


def encode(seq: int, *fields: str | int) -> bytes:
    """Return the line of a message, newline included.

    Raises ValueError: a sequence number out of range, a field that cannot stand on a line, or a line of more than 96
    bytes.
    """
    if not 0 <= seq <= LAST_SEQ:
        raise ValueError(f"sequence number {seq} is not in 0 ... {LAST_SEQ}")
    words = [str(field) for field in fields]
    if not words or not all(_plain(word) for word in words):
        raise ValueError(f"{words} cannot stand on a line: printable ASCII without '$', '*' and ','")
    body = ",".join((str(seq), *words)).encode("ascii")
    line = b"$%s*%04X\n" % (body, checksum(body))
    if len(line) > MAX_LINE_BYTES:
        raise ValueError(f"a line of {len(line)} bytes, and {MAX_LINE_BYTES} is the most: {line!r}")
    return line


def decode(line: bytes) -> Line | None:
    """Return what a line says, given without its newline; None for anything but a whole line with a right checksum.

    What stands before the last ``$`` is left out: it is the rest of a line whose end got lost.
    """
    start = line.rfind(b"$")
    if start < 0 or len(line) - start >= MAX_LINE_BYTES:
        return None
    body, star, digits = line[start + 1 :].partition(b"*")
    if not star or len(digits) != _CRC_BYTES or any(digit not in _CRC_DIGITS for digit in digits):
        return None
    if int(digits, 16) != checksum(body):
        return None
    number, comma, rest = body.partition(b",")
    if not comma or not number.isdigit() or len(number) > 5 or int(number) > LAST_SEQ:
        return None
    if any(not 0x20 <= byte < 0x7F for byte in rest):
        return None
    return Line(int(number), tuple(rest.decode("ascii").split(",")))


class LineParser:
    """Takes bytes as they come, in pieces of any size, and returns the lines among them.

    Attributes
    ----------
    accepted, rejected
        Lines with a right checksum, and those dropped: damaged, too long, or no line of this protocol.
    """

    def __init__(self) -> None:
        self.accepted = 0
        self.rejected = 0
        self._rest = bytearray()
        self._cut = False

    def feed(self, data: bytes) -> list[Line]:
        """Return the lines that these bytes complete. Keeps at most one line's bytes; never raises."""
        lines: list[Line] = []
        *ended, rest = data.split(b"\n")
        for piece in ended:
            self._keep(piece)
            line = decode(bytes(self._rest))
            if line is not None:
                self.accepted += 1
                lines.append(line)
            elif self._rest or self._cut:
                self.rejected += 1
            self._rest.clear()
            self._cut = False
        self._keep(rest)
        return lines

    def reset(self) -> None:
        """Forget the beginning of a line, and the counts."""
        self._rest.clear()
        self._cut = False
        self.accepted = self.rejected = 0

    def _keep(self, piece: bytes) -> None:
        """Add to the line under way; of one that is too long only what could be a whole line at its end is kept."""
        self._rest += piece
        excess = len(self._rest) - (MAX_LINE_BYTES - 1)
        if excess > 0:
            del self._rest[:excess]
            self._cut = True


def _plain(word: str) -> bool:
    return word.isascii() and word.isprintable() and not any(mark in word for mark in "$*,")
