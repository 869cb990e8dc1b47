"""The model: which bodies Motive streams, and under which numbers."""

import struct
from collections.abc import Callable
from dataclasses import dataclass

from labrun_plugins.optitrack.messages import I32, Cursor, Malformed, Version

_SIZED: Version = (4, 1)
_BODY = struct.Struct("<ii3f")
_MARKER_SET, _RIGID_BODY, _SKELETON, _FORCE_PLATE, _DEVICE, _CAMERA = range(6)


@dataclass(frozen=True, slots=True)
class BodyModel:
    """A rigid body of Motive: its name, its number in the frames, and how many markers it has (None before 3.0)."""

    name: str
    id: int
    markers: int | None


def decode_model(payload: bytes, version: Version) -> tuple[BodyModel, ...] | None:
    """Return the rigid bodies of a MODELDEF; None if the payload is not one in the layout of that version.

    Before 4.1 descriptions have no sizes. What comes after the bodies and cannot be walked through (force plates,
    devices, cameras) ends the reading, and the bodies count; what comes before them makes the model unreadable.
    """
    try:
        return _model(Cursor(payload), version)
    except Malformed:
        return None


def _model(cursor: Cursor, version: Version) -> tuple[BodyModel, ...]:
    bodies: list[BodyModel] = []
    for _ in range(cursor.count(4)):
        kind = int(cursor.number(I32))
        if version >= _SIZED:
            item = cursor.part(int(cursor.number(I32)))
            if kind == _RIGID_BODY:
                bodies.append(_body(item, version))
            continue
        if kind == _RIGID_BODY:
            bodies.append(_body(cursor, version))
        elif kind in (_MARKER_SET, _SKELETON):
            _PASS[kind](cursor, version)
        else:
            try:
                _PASS[kind](cursor, version)
            except (Malformed, KeyError):
                break
    return tuple(bodies)


def _body(cursor: Cursor, version: Version) -> BodyModel:
    name = cursor.text()
    number, *_ = cursor.take(_BODY)
    if version >= (4, 2):
        cursor.skip(16)
    if version < (3, 0):
        return BodyModel(name, number, None)
    markers = cursor.count(16)
    cursor.skip(markers * 16)  # places, active labels
    if version >= (4, 0):
        for _ in range(markers):
            cursor.text()
    return BodyModel(name, number, markers)


def _pass_marker_set(cursor: Cursor, _version: Version) -> None:
    cursor.text()
    _pass_names(cursor)


def _pass_skeleton(cursor: Cursor, version: Version) -> None:
    cursor.text()
    cursor.skip(4)
    for _ in range(cursor.count(21)):
        _body(cursor, version)


def _pass_force_plate(cursor: Cursor, _version: Version) -> None:
    cursor.skip(4)
    cursor.text()
    cursor.skip(4 * (2 + 3 + 144 + 12) + 8)  # size, origin, calibration, corners, two kinds
    _pass_names(cursor)


def _pass_device(cursor: Cursor, _version: Version) -> None:
    cursor.skip(4)
    cursor.text()
    cursor.text()
    cursor.skip(8)
    _pass_names(cursor)


def _pass_camera(cursor: Cursor, _version: Version) -> None:
    cursor.text()
    cursor.skip(28)


def _pass_names(cursor: Cursor) -> None:
    for _ in range(cursor.count(1)):
        cursor.text()


_PASS: dict[int, Callable[[Cursor, Version], None]] = {
    _MARKER_SET: _pass_marker_set,
    _SKELETON: _pass_skeleton,
    _FORCE_PLATE: _pass_force_plate,
    _DEVICE: _pass_device,
    _CAMERA: _pass_camera,
}
