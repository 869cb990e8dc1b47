"""Reading little-endian bytes without ever looking past the last one."""

import struct
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

    Parameters
    ----------
    data
        The payload.

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
