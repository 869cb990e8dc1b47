"""The server's side of NatNet, in bytes: what Motive sends, and how it understands what clients send.

Written from the layout alone; the driver reads frames with code of its own.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

Version = tuple[int, int]
Vector = Sequence[float]

CONNECT, SERVERINFO, REQUEST, RESPONSE, REQUEST_MODELDEF, MODELDEF = range(6)
FRAMEOFDATA, DISCONNECT, KEEPALIVE, DISCONNECTBYTIMEOUT, ECHOREQUEST, ECHORESPONSE = 7, 9, 10, 11, 12, 13
UNRECOGNIZED_REQUEST = 100


@dataclass(frozen=True)
class RigidBody:
    """A body in a frame."""

    id: int
    position: Vector
    orientation: Vector
    error: float = 0.0
    params: int = 1


@dataclass(frozen=True)
class LabelledMarker:
    """A marker in a frame; the model stands in the high half of `id`."""

    id: int
    position: Vector
    size: float = 0.0127
    params: int = 0x0A
    residual: float = 0.0002


@dataclass(frozen=True)
class Analog:
    """A force plate or another device: channels, each with the samples of the frame."""

    id: int
    channels: Sequence[Vector]


@dataclass(frozen=True)
class Content:
    """All a frame may hold; `stamped` tells whether a 4.0 frame has precision stamps."""

    number: int
    bodies: Sequence[RigidBody] = ()
    marker_sets: Sequence[tuple[str, Sequence[Vector]]] = ()
    others: Sequence[Vector] = ()
    skeletons: Sequence[tuple[int, Sequence[RigidBody]]] = ()
    assets: Sequence[tuple[int, Sequence[RigidBody], Sequence[LabelledMarker]]] = ()
    markers: Sequence[LabelledMarker] = ()
    plates: Sequence[Analog] = ()
    devices: Sequence[Analog] = ()
    timestamp: float = 0.0
    ticks: tuple[int, int, int] = (0, 0, 0)
    precision: tuple[int, int] = (0, 0)
    params: int = 0
    stamped: bool = True

    def numbered(self, number: int) -> "Content":
        """Return the same with another number."""
        return replace(self, number=number)


@dataclass(frozen=True)
class BodyDescription:
    """A body of the model."""

    name: str
    id: int
    markers: Sequence[Vector] = field(default_factory=tuple)


def message(number: int, payload: bytes = b"") -> bytes:
    """Return a datagram."""
    return struct.pack("<HH", number, len(payload)) + payload


def understand(datagram: bytes) -> tuple[int, bytes] | None:
    """Return number and payload of what a client sent; clients are careless with the size, so it is not minded."""
    if len(datagram) < 4:
        return None
    (number,) = struct.unpack_from("<H", datagram)
    return number, datagram[4:]


def connect_form(payload: bytes) -> tuple[str, Version | None]:
    """Return which form of CONNECT this is, and the layout it asks for."""
    if payload.startswith(b"Ping") and len(payload) >= 268:
        wanted = payload[265], payload[266]
        return "long", wanted if wanted[0] else None
    if payload.startswith(b"Ping"):
        return "short", None
    return "named" if len(payload) >= 264 else "odd", None


def server_info(
    app: Sequence[int], natnet: Sequence[int], clock_hz: int, port: int, multicast: bool, group: str
) -> bytes:
    """Return who the server is. After the name's end stands garbage, as in Motive's own."""
    name = b"Motive\0".ljust(256, b"\xcd")
    payload = name + bytes(app) + bytes(natnet)
    if natnet[0] >= 3:
        payload += struct.pack("<QHB", clock_hz, port, multicast)
        payload += bytes(int(part) for part in group.split("."))
    return message(SERVERINFO, payload)


def number_response(value: float) -> bytes:
    """Return the answer to a question for a number."""
    return message(RESPONSE, struct.pack("<f", value))


def text_response(text: str) -> bytes:
    """Return the answer to a question for a text."""
    return message(RESPONSE, text.encode() + b"\0")


def echo_response(client_ticks: int, server_ticks: int) -> bytes:
    """Return the server's clock beside the client's."""
    return message(ECHORESPONSE, struct.pack("<QQ", client_ticks, server_ticks))


def frame(content: Content, version: Version) -> bytes:
    """Return a frame in the layout of a version from 3.0 on."""
    sections = [
        [_text(name) + _vectors(places) for name, places in content.marker_sets],
        [_floats(marker) for marker in content.others],
        [_body(body) for body in content.bodies],
        [struct.pack("<i", id_) + _bodies(bodies) for id_, bodies in content.skeletons],
    ]
    if version >= (4, 1):
        sections.append([
            struct.pack("<i", id_) + _bodies(bodies) + _count(markers) + b"".join(map(_marker, markers))
            for id_, bodies, markers in content.assets
        ])  # fmt: skip
    sections += [
        [_marker(marker) for marker in content.markers],
        [_analog(plate) for plate in content.plates],
        [_analog(device) for device in content.devices],
    ]
    payload = struct.pack("<i", content.number)
    for items in sections:
        body = b"".join(items)
        payload += _count(items) + (struct.pack("<i", len(body)) if version >= (4, 1) else b"") + body
    payload += struct.pack("<IId3Q", 0, 0, content.timestamp, *content.ticks)
    if version >= (4, 1) or (version >= (4, 0) and content.stamped):
        payload += struct.pack("<II", *content.precision)
    payload += struct.pack("<hI", content.params, 0)
    return message(FRAMEOFDATA, payload)


def model(bodies: Sequence[BodyDescription], version: Version, *, rich: bool = True) -> bytes:
    """Return the model; `rich` puts other things before and after the bodies."""
    items = [(1, _body_description(body, version)) for body in bodies]
    if rich:
        first = bodies[0]
        items.insert(0, (0, _text("all") + struct.pack("<i", 2) + _text("one") + _text("two")))
        items.append((2, _text("person") + struct.pack("<ii", 7, 1) + _body_description(first, version)))
        plate = struct.pack("<i", 1) + _text("plate-1") + bytes(4 * (2 + 3 + 144 + 12) + 8)
        items.append((3, plate + struct.pack("<i", 2) + _text("Fx") + _text("Fy")))
        device = struct.pack("<i", 1) + _text("daq") + _text("serial") + bytes(8)
        items.append((4, device + struct.pack("<i", 1) + _text("a0")))
        items.append((5, _text("Prime 17W #1") + _floats((0, 2, 0, 0, 0, 0, 1))))
        if version >= (4, 1):
            items.append((6, _text("skin") + struct.pack("<4i", 1, 9, 0, 0)))
    payload = struct.pack("<i", len(items))
    for kind, body in items:
        payload += struct.pack("<i", kind)
        payload += (struct.pack("<i", len(body)) if version >= (4, 1) else b"") + body
    return message(MODELDEF, payload)


def _body_description(body: BodyDescription, version: Version) -> bytes:
    data = _text(body.name) + struct.pack("<ii3f", body.id, -1, 0.0, 0.0, 0.0)
    if version >= (4, 2):
        data += struct.pack("<4f", 0.0, 0.0, 0.0, 1.0)
    data += _vectors(body.markers) + struct.pack(f"<{len(body.markers)}i", *range(1, len(body.markers) + 1))
    if version >= (4, 0):
        data += b"".join(_text(f"Marker {number + 1}") for number in range(len(body.markers)))
    return data


def _body(body: RigidBody) -> bytes:
    values = (body.id, *body.position, *body.orientation, body.error, body.params)
    return struct.pack("<i3f4ffh", *values)


def _bodies(bodies: Sequence[RigidBody]) -> bytes:
    return _count(bodies) + b"".join(map(_body, bodies))


def _marker(marker: LabelledMarker) -> bytes:
    return struct.pack("<i3ffhf", marker.id, *marker.position, marker.size, marker.params, marker.residual)


def _analog(analog: Analog) -> bytes:
    channels = (_count(samples) + _floats(samples) for samples in analog.channels)
    return struct.pack("<i", analog.id) + _count(analog.channels) + b"".join(channels)


def _vectors(vectors: Sequence[Vector]) -> bytes:
    return _count(vectors) + b"".join(map(_floats, vectors))


def _count(items: Sequence[object]) -> bytes:
    return struct.pack("<i", len(items))


def _floats(values: Vector) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


def _text(text: str) -> bytes:
    return text.encode() + b"\0"
