"""What a data package holds: names and types, agreed with the controller."""

import struct
from collections.abc import Mapping, Sequence
from typing import Any

_FORMATS = {
    "BOOL": "B",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
NOT_FOUND = "NOT_FOUND"
IN_USE = "IN_USE"


class Recipe:
    """Names and types of a data package.

    Parameters
    ----------
    number
        By which the controller calls it; None in the outputs of protocol 1, which carry no number.
    names, types
        Of its variables, in order.

    Raises
    ------
    ValueError
        A type that RTDE does not have, or not one type for each name.
    """

    def __init__(self, number: int | None, names: Sequence[str], types: Sequence[str]) -> None:
        if len(names) != len(types):
            raise ValueError(f"{len(types)} types for {len(names)} names")
        unknown = [one for one in types if one not in _FORMATS]
        if unknown:
            raise ValueError(f"unknown type {unknown[0][:40]!r}")
        self.number = number
        self.names = tuple(names)
        self.types = tuple(types)
        formats = [_FORMATS[one] for one in types]
        self._struct = struct.Struct(">" + ("" if number is None else "B") + "".join(formats))
        self._places: dict[str, tuple[int, int]] = {}
        place = 0 if number is None else 1
        for name, form in zip(names, formats, strict=True):
            width = int(form[:-1] or 1)
            self._places[name] = (place, width)
            place += width

    @property
    def size(self) -> int:
        """Bytes of a payload."""
        return self._struct.size

    def decode(self, payload: bytes) -> dict[str, Any] | None:
        """Return values by name (vectors as tuples); None if this is no data of this recipe."""
        if len(payload) != self._struct.size:
            return None
        flat = self._struct.unpack(payload)
        if self.number is not None and flat[0] != self.number:
            return None
        return {
            name: flat[place] if width == 1 else flat[place : place + width]
            for name, (place, width) in self._places.items()
        }

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """Return the payload of a data package with these values."""
        flat: list[Any] = [] if self.number is None else [self.number]
        for name, (_, width) in self._places.items():
            flat += [values[name]] if width == 1 else list(values[name])
        return self._struct.pack(*flat)
