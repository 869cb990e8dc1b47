"""A frame of data: from NatNet 2.0 to 4.2, and what later versions keep of it.

Sections come in a fixed order, each with its count. From 4.1 on the size of each section follows its count, and all
that is not needed is passed over by that size; before, every item has to be walked through.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

from labrun_plugins.optitrack.messages import F32, F64, I16, I32, Cursor, Malformed, Version

_SIZED: Version = (4, 1)
_NEWEST: Version = (4, 2)
"""The last version whose suffix is known to the byte."""
_POSE = struct.Struct("<i3f4f")
_MARKER = struct.Struct("<i3f")
_TICKS = struct.Struct("<3Q")
_STAMPS = struct.Struct("<2I")
_END_TAG = 4
_UNIT_SLACK = 0.01

TRACKED = 0x01
RECORDING, MODELS_CHANGED, EDIT_MODE, BITSTREAM_CHANGED = 0x01, 0x02, 0x04, 0x08
OCCLUDED, MODEL_FILLED = 0x01, 0x04


@dataclass(frozen=True, slots=True)
class Body:
    """A rigid body: position in m, orientation (x, y, z, w), mean error of its markers in m."""

    id: int
    pose: tuple[float, ...]
    error_m: float
    params: int

    @property
    def measured(self) -> bool:
        """Tell whether this is a measurement: tracked in this frame, and a pose at all."""
        return (
            bool(self.params & TRACKED)
            and all(map(math.isfinite, self.pose))
            and abs(math.hypot(*self.pose[3:]) - 1.0) < _UNIT_SLACK
        )


@dataclass(frozen=True, slots=True)
class Marker:
    """A labelled marker: id (model in the high half, its number in the low half), position in m."""

    id: int
    position: tuple[float, ...]
    params: int

    @property
    def measured(self) -> bool:
        """Tell whether cameras saw it: neither hidden nor filled in from the model."""
        return not self.params & (OCCLUDED | MODEL_FILLED) and all(map(math.isfinite, self.position))


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame.

    Attributes
    ----------
    number
        Counts frames; signed, 32 bit.
    bodies, markers
        Rigid bodies, and labelled markers if they were asked for.
    timestamp_s
        Software clock of Motive.
    exposed, received, sent
        Ticks of the server's clock at mid-exposure, at receipt of the images, at transmission; None before 3.0.
    precision
        Seconds and fraction of the precision clock; None if the layout has none.
    params
        Recording, models changed, edit mode, bitstream changed.
    """

    number: int
    bodies: tuple[Body, ...]
    markers: tuple[Marker, ...]
    timestamp_s: float
    exposed: int | None
    received: int | None
    sent: int | None
    precision: tuple[int, int] | None
    params: int


def decode_frame(payload: bytes, version: Version, *, with_markers: bool = False) -> Frame | None:
    """Return the frame of a payload; None if the payload is not a whole frame in the layout of that version."""
    try:
        return _frame(Cursor(payload), version, with_markers)
    except Malformed:
        return None


def _frame(cursor: Cursor, version: Version, with_markers: bool) -> Frame:
    number = int(cursor.number(I32))
    _pass_over(cursor, version, 5, _pass_marker_set)
    _pass_over(cursor, version, 12, lambda rest: rest.skip(12))
    bodies = _bodies(cursor, version)
    if version >= (2, 1):
        _pass_over(cursor, version, 8, lambda rest: _pass_skeleton(rest, version))
    if version >= _SIZED:
        _pass_over(cursor, version, 12, lambda _: None)  # assets; never without a size
    markers = _markers(cursor, version, with_markers) if version >= (2, 3) else ()
    if version >= (2, 9):
        _pass_over(cursor, version, 8, _pass_analog)
    if version >= (2, 11):
        _pass_over(cursor, version, 8, _pass_analog)
    suffix = _modern_suffix if version >= (3, 0) else _old_suffix
    timestamp_s, ticks, precision, params = suffix(cursor, version)
    if not math.isfinite(timestamp_s):
        raise Malformed("a time that is not a number")
    return Frame(number, bodies, markers, timestamp_s, *ticks, precision, params)


def _section(cursor: Cursor, version: Version, least: int) -> tuple[int, Cursor]:
    """Return how many items a section has, and where they are read: from 4.1 on nothing else can be reached there."""
    count = cursor.count(least)
    if version < _SIZED:
        return count, cursor
    section = cursor.part(int(cursor.number(I32)))
    if count * least > section.left:
        raise Malformed(f"{count} items of {least} bytes or more in a section of {section.left} bytes")
    return count, section


def _pass_over(cursor: Cursor, version: Version, least: int, pass_item: Callable[[Cursor], None]) -> None:
    count, section = _section(cursor, version, least)
    if version < _SIZED:
        for _ in range(count):
            pass_item(section)


def _bodies(cursor: Cursor, version: Version) -> tuple[Body, ...]:
    size = 38 if version >= (3, 0) else 42 if version >= (2, 6) else 40
    count, section = _section(cursor, version, size)
    bodies = tuple(_body(section, version) for _ in range(count))
    if version >= _SIZED and section.left:
        raise Malformed("rigid bodies of another size")
    return bodies


def _body(cursor: Cursor, version: Version) -> Body:
    number, *pose = cursor.take(_POSE)
    if version < (3, 0):
        cursor.skip(cursor.count(20) * 20)  # its markers: place, id, size
    error_m = float(cursor.number(F32))
    # Before 2.6 nothing tells whether a body is tracked.
    params = int(cursor.number(I16)) if version >= (2, 6) else TRACKED
    return Body(number, tuple(pose), error_m, params)


def _markers(cursor: Cursor, version: Version, wanted: bool) -> tuple[Marker, ...]:
    size = 26 if version >= (3, 0) else 22 if version >= (2, 6) else 20
    count, section = _section(cursor, version, size)
    if not wanted:
        if version < _SIZED:
            section.skip(count * size)
        return ()
    markers = []
    for _ in range(count):
        item = section.part(size)
        number, *position = item.take(_MARKER)
        item.skip(4)
        markers.append(Marker(number, tuple(position), int(item.number(I16)) if version >= (2, 6) else 0))
    return tuple(markers)


def _pass_marker_set(cursor: Cursor) -> None:
    cursor.text()
    cursor.skip(cursor.count(12) * 12)


def _pass_skeleton(cursor: Cursor, version: Version) -> None:
    cursor.skip(4)
    for _ in range(cursor.count(38)):
        _body(cursor, version)


def _pass_analog(cursor: Cursor) -> None:
    cursor.skip(4)
    for _ in range(cursor.count(4)):
        cursor.skip(cursor.count(4) * 4)


_Ticks = tuple[int | None, int | None, int | None]
_Suffix = tuple[float, _Ticks, tuple[int, int] | None, int]


def _modern_suffix(cursor: Cursor, version: Version) -> _Suffix:
    core = 8 + F64.size + _TICKS.size + I16.size
    # 4.0 was sent with and without precision stamps: the bytes that are left tell (46 or 54 with the end tag).
    stamped = version >= _SIZED or (version >= (4, 0) and cursor.left >= core + _STAMPS.size)
    after = cursor.left - core - (_STAMPS.size if stamped else 0)
    # All captures before 4.1 end with a tag; whether all frames after do is not known.
    fits = after == _END_TAG or (version >= _SIZED and after == 0) or (version > _NEWEST and after > 0)
    if not fits:
        raise Malformed(f"{cursor.left} bytes after the sections")
    cursor.skip(8)  # timecode
    timestamp_s = float(cursor.number(F64))
    exposed, received, sent = cursor.take(_TICKS)
    precision = cursor.take(_STAMPS) if stamped else None
    return timestamp_s, (exposed, received, sent), precision, int(cursor.number(I16))


def _old_suffix(cursor: Cursor, version: Version) -> _Suffix:
    time = F64 if version >= (2, 7) else F32
    after = cursor.left - (8 + time.size + I16.size)
    if after - F32.size == _END_TAG:
        cursor.skip(F32.size)  # the latency that some 2.x servers send before the timecode
    elif after not in (0, _END_TAG):
        raise Malformed(f"{cursor.left} bytes after the sections")
    cursor.skip(8)
    return float(cursor.number(time)), (None, None, None), None, int(cursor.number(I16))
