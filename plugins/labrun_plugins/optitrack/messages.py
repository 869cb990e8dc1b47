"""NatNet messages: a header of two u16, little-endian, and a payload; bytes are never looked at past the last one."""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

F32 = struct.Struct("<f")
F64 = struct.Struct("<d")
I16 = struct.Struct("<h")
I32 = struct.Struct("<i")
U64 = struct.Struct("<Q")


class Malformed(ValueError):  # noqa: N818  what arrived is not what it claims to be; not an error of ours
    """Bytes end too early, or count more items than they have room for."""


class Cursor:
    """A place in a payload that only moves on.

    Raises
    ------
    Malformed
        By every method that asks for more than is left.
    """

    __slots__ = ("_at", "_data")

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = memoryview(data)
        self._at = 0

    @property
    def left(self) -> int:
        """How many bytes are left."""
        return len(self._data) - self._at

    def take(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Return the next values."""
        return layout.unpack(self._next(layout.size))

    def number(self, layout: struct.Struct) -> Any:
        """Return the next value of a layout that has one."""
        return layout.unpack(self._next(layout.size))[0]

    def skip(self, count: int) -> None:
        """Pass over some bytes."""
        self._next(count)

    def part(self, size: int) -> "Cursor":
        """Return the next bytes as something to be read on its own, and pass over them."""
        return Cursor(self._next(size))

    def count(self, least: int) -> int:
        """Return how many items follow, each of `least` bytes at least."""
        count = int(self.number(I32))
        if count < 0 or count * least > self.left:
            raise Malformed(f"{count} items of {least} bytes or more in {self.left} bytes")
        return count

    def text(self) -> str:
        """Return the text up to the next NUL, and pass over both."""
        rest = bytes(self._data[self._at :])
        length = rest.find(0)
        if length < 0:
            raise Malformed("text without an end")
        self._at += length + 1
        return rest[:length].decode("utf-8", errors="replace")

    def _next(self, size: int) -> memoryview:
        if not 0 <= size <= self.left:
            raise Malformed(f"{size} bytes wanted, {self.left} left")
        piece = self._data[self._at : self._at + size]
        self._at += size
        return piece


Version = tuple[int, int]

_HEADER = struct.Struct("<HH")
_SERVER = struct.Struct("<256s4B4B")
_SERVER_3 = struct.Struct("<QHB4B")
_ECHO = struct.Struct("<QQ")
_PING = b"Ping\0"
_CONNECT_SIZE = 270
_VERSION_AT = 265


class MessageId(IntEnum):
    """What a datagram is."""

    CONNECT = 0
    SERVERINFO = 1
    REQUEST = 2
    RESPONSE = 3
    REQUEST_MODELDEF = 4
    MODELDEF = 5
    REQUEST_FRAMEOFDATA = 6
    FRAMEOFDATA = 7
    MESSAGESTRING = 8
    DISCONNECT = 9
    KEEPALIVE = 10
    DISCONNECTBYTIMEOUT = 11
    ECHOREQUEST = 12
    ECHORESPONSE = 13
    DISCOVERY = 14
    UNRECOGNIZED_REQUEST = 100


def encode(message: MessageId, payload: bytes = b"") -> bytes:
    """Return a whole datagram."""
    return _HEADER.pack(message, len(payload)) + payload


def split(datagram: bytes) -> tuple[int, bytes] | None:
    """Return message number and payload; None if fewer bytes arrived than the header says.

    Bytes beyond the size are passed over: senders add a NUL that they do not count.
    """
    if len(datagram) < _HEADER.size:
        return None
    message, size = _HEADER.unpack_from(datagram)
    if len(datagram) < _HEADER.size + size:
        return None
    return message, datagram[_HEADER.size : _HEADER.size + size]


def connect() -> bytes:
    """Return the short request to be served, which every version knows."""
    return encode(MessageId.CONNECT, _PING)


def connect_with_version(version: Version) -> bytes:
    """Return the long request to be served, as NatNet 4 has it, which asks for a layout of the frames."""
    payload = bytearray(_PING.ljust(_CONNECT_SIZE, b"\0"))
    payload[_VERSION_AT : _VERSION_AT + 2] = bytes(version)
    return encode(MessageId.CONNECT, bytes(payload))


def request(command: str) -> bytes:
    """Return a text command."""
    return encode(MessageId.REQUEST, command.encode() + b"\0")


def echo_request(ticks: int) -> bytes:
    """Return a question for the server's clock; it sends `ticks` back."""
    return encode(MessageId.ECHOREQUEST, U64.pack(ticks % 2**64))


def echo_ticks(payload: bytes) -> tuple[int, int] | None:
    """Return (own ticks, server's ticks) of the answer to an echo request."""
    return _ECHO.unpack_from(payload) if len(payload) >= _ECHO.size else None


def answered_number(payload: bytes) -> float | None:
    """Return the f32 of a response; None if it is something else."""
    return float(F32.unpack(payload)[0]) if len(payload) == F32.size else None


@dataclass(frozen=True, slots=True)
class ServerInfo:
    """What the server says of itself.

    Attributes
    ----------
    name
        Of the program: "Motive".
    app, natnet
        Versions, four numbers each.
    clock_hz
        Ticks a second of its clock; None before NatNet 3, which has no such clock.
    data_port, multicast, group
        How it sends frames; None before NatNet 3.
    """

    name: str
    app: tuple[int, ...]
    natnet: tuple[int, ...]
    clock_hz: int | None = None
    data_port: int | None = None
    multicast: bool | None = None
    group: str | None = None

    @property
    def version(self) -> Version:
        """The NatNet version as it decides layouts."""
        return self.natnet[0], self.natnet[1]


def server_info(payload: bytes) -> ServerInfo | None:
    """Return what a SERVERINFO says; None if it is too short to be one."""
    if len(payload) < _SERVER.size:
        return None
    raw_name, *numbers = _SERVER.unpack_from(payload)
    name = raw_name.partition(b"\0")[0].decode("utf-8", errors="replace")
    printable = "".join(letter for letter in name if letter.isprintable())
    app, natnet = tuple(numbers[:4]), tuple(numbers[4:])
    if natnet[0] < 3 or len(payload) < _SERVER.size + _SERVER_3.size:
        return ServerInfo(printable, app, natnet)
    clock_hz, port, multicast, *group = _SERVER_3.unpack_from(payload, _SERVER.size)
    return ServerInfo(
        printable, app, natnet, clock_hz or None, port, bool(multicast), ".".join(str(byte) for byte in group)
    )


def dotted(version: tuple[int, ...]) -> str:
    """Return a version as people write it."""
    return ".".join(str(number) for number in version)
