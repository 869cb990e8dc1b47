"""Messages of the primary port: what the controller says about a program.

A package is ``size u32, type u8, payload``, big-endian. Type 20 is a message: ``time u64, source u8, kind u8``, then
for kind 10 (a program failed) ``line i32, column i32, text`` and for kind 6 (the controller reports) ``code i32,
argument i32, level i32, data type u32, data u32, text`` (UR client interface; src/primary of
`UniversalRobots/Universal_Robots_Client_Library`).
"""

import struct
from dataclasses import dataclass, field

from labrun_plugins.ur5.packages import readable

_HEADER = struct.Struct(">IB")
_MESSAGE = 20
_PREFIX = struct.Struct(">QbB")
_EXCEPTION, _REPORT = 10, 6
_EXCEPTION_PLACE = struct.Struct(">ii")
_REPORT_HEAD = struct.Struct(">iiiII")
_VIOLATION = 3
"""Least level of a report that ends a move: 3 violation, 4 fault; 2, warnings, may be about a fan."""
_DEBUG = 128
_MOST = 65_536


@dataclass
class PrimaryStream:
    """Picks complaints out of what a primary port sends, and skips the rest (its state at 10 Hz)."""

    broken: bool = False
    _rest: bytearray = field(default_factory=bytearray)

    def feed(self, data: bytes) -> list[str]:
        """Return the complaints that are complete now, each as one line."""
        if self.broken:
            return []
        found: list[str] = []
        rest = self._rest
        rest += data
        begin = 0
        while len(rest) - begin >= _HEADER.size:
            size, kind = _HEADER.unpack_from(rest, begin)
            if not _HEADER.size <= size <= _MOST:
                self.broken = True
                rest.clear()
                return found
            if len(rest) - begin < size:
                break
            if kind == _MESSAGE:
                complaint = complaint_of(bytes(rest[begin + _HEADER.size : begin + size]))
                if complaint:
                    found.append(complaint)
            begin += size
        del rest[:begin]
        return found


def complaint_of(payload: bytes) -> str:
    """Return what a message complains about; empty if it is none."""
    if len(payload) < _PREFIX.size:
        return ""
    _, _, kind = _PREFIX.unpack_from(payload)
    body = payload[_PREFIX.size :]
    if kind == _EXCEPTION and len(body) >= _EXCEPTION_PLACE.size:
        line, column = _EXCEPTION_PLACE.unpack_from(body)
        return f"line {line}, column {column}: {readable(body[_EXCEPTION_PLACE.size :])}"
    if kind == _REPORT and len(body) >= _REPORT_HEAD.size:
        code, argument, level, _, _ = _REPORT_HEAD.unpack_from(body)
        if _VIOLATION <= level < _DEBUG:
            return f"C{code}A{argument} {readable(body[_REPORT_HEAD.size :])}".strip()
    return ""
