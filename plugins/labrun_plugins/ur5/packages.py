"""RTDE on the wire: packages of a size, a type and a payload, all big-endian."""

import struct
from dataclasses import dataclass, field
from typing import NamedTuple

VERSION_REQUEST = ord("V")
CONTROLLER_VERSION = ord("v")
OUTPUTS = ord("O")
INPUTS = ord("I")
START = ord("S")
PAUSE = ord("P")
DATA = ord("U")
TEXT = ord("M")
_TYPES = frozenset((VERSION_REQUEST, CONTROLLER_VERSION, OUTPUTS, INPUTS, START, PAUSE, DATA, TEXT))

_HEADER = struct.Struct(">HB")
_MOST = 4096
"""Longest package taken for one: names of a recipe are at most 2048 bytes, a text two times 255."""
MOST_NAMES = 2048


class Package(NamedTuple):
    """A type byte and its payload."""

    kind: int
    payload: bytes


@dataclass
class PackageStream:
    """Cuts what arrives into packages, however it was chopped up.

    TCP loses no bytes, so that a header that cannot be one means that the stream has lost its way for good: from then
    on `broken` says why, and nothing more is returned.
    """

    broken: str = ""
    _rest: bytearray = field(default_factory=bytearray)

    def feed(self, data: bytes) -> list[Package]:
        """Return the packages that are complete now."""
        packages: list[Package] = []
        if self.broken:
            return packages
        rest = self._rest
        rest += data
        begin = 0
        while len(rest) - begin >= _HEADER.size:
            size, kind = _HEADER.unpack_from(rest, begin)
            if not _HEADER.size <= size <= _MOST:
                self.broken = f"a package of {size} bytes (3 to {_MOST} are possible)"
                break
            if kind not in _TYPES:
                self.broken = f"a package of unknown type {kind:#04x}"
                break
            if len(rest) - begin < size:
                break
            packages.append(Package(kind, bytes(rest[begin + _HEADER.size : begin + size])))
            begin += size
        del rest[:begin]
        if self.broken:
            rest.clear()
        return packages


def encode(kind: int, payload: bytes = b"") -> bytes:
    """Return a package."""
    return _HEADER.pack(_HEADER.size + len(payload), kind) + payload


def protocol_request(version: int) -> bytes:
    """Return the request to speak this version of the protocol."""
    return encode(VERSION_REQUEST, struct.pack(">H", version))


def outputs_request(names: tuple[str, ...], rate_hz: float | None) -> bytes:
    """Return the request for a stream of these variables; protocol 1 knows no rate (None)."""
    frequency = b"" if rate_hz is None else struct.pack(">d", rate_hz)
    return encode(OUTPUTS, frequency + _joined(names))


def inputs_request(names: tuple[str, ...]) -> bytes:
    """Return the request to write these variables."""
    return encode(INPUTS, _joined(names))


def accepted(payload: bytes) -> bool:
    """Tell whether the controller agreed, from the payload of its reply to V, S or P."""
    return payload == b"\x01"


def controller_version(payload: bytes) -> tuple[int, int, int, int] | None:
    """Return major, minor, bugfix and build; None from anything else."""
    return struct.unpack(">4I", payload) if len(payload) == 16 else None


def types_of(payload: bytes, *, with_recipe: bool) -> tuple[int, tuple[str, ...]]:
    """Return recipe number (0 without one) and types from the payload of a reply to O or I."""
    number = 0
    if with_recipe:
        if not payload:
            return 0, ()
        number, payload = payload[0], payload[1:]
    text = payload.decode("ascii", errors="replace")
    return number, tuple(part for part in text.split(",") if part)


class Text(NamedTuple):
    """A message of the controller; level 0 exception, 1 error, 2 warning, 3 information."""

    message: str
    source: str
    level: int


def text_of(payload: bytes) -> Text | None:
    """Return a text message of protocol 2; None from anything else."""
    if not payload or len(payload) < payload[0] + 2:
        return None
    end = 1 + payload[0]
    source_end = end + 1 + payload[end]
    if len(payload) != source_end + 1:
        return None
    return Text(readable(payload[1:end]), readable(payload[end + 1 : source_end]), payload[source_end])


def readable(text: bytes) -> str:
    """Return a device's text as one printable line of at most 200 characters."""
    line = text.decode("utf-8", errors="replace")
    return "".join(one if one.isprintable() else " " for one in line).strip()[:200]


def _joined(names: tuple[str, ...]) -> bytes:
    joined = ",".join(names).encode("ascii")
    if len(joined) > MOST_NAMES:
        raise ValueError(f"{len(joined)} bytes of names; the controller takes {MOST_NAMES}")
    return joined
