"""RTDE as the controller speaks it, written from the protocol's description."""

import math
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from labrun.devices.emulation import EmulatorLog, Faults

_WIDTHS = {
    "BOOL": ("B", 1), "UINT8": ("B", 1), "UINT32": ("I", 1), "UINT64": ("Q", 1), "INT32": ("i", 1),
    "DOUBLE": ("d", 1), "VECTOR3D": ("d", 3), "VECTOR6D": ("d", 6), "VECTOR6INT32": ("i", 6),
    "VECTOR6UINT32": ("I", 6),
}  # fmt: skip
_INPUTS = (
    (re.compile(r"input_int_register_([0-9]|[1-3][0-9]|4[0-7])"), "INT32"),
    (re.compile(r"input_double_register_([0-9]|[1-3][0-9]|4[0-7])"), "DOUBLE"),
    (re.compile(r"speed_slider_mask"), "UINT32"),
    (re.compile(r"speed_slider_fraction"), "DOUBLE"),
    (re.compile(r"standard_digital_output(_mask)?"), "UINT8"),
)
Values = Mapping[str, tuple[str, Any]]


def framed(kind: str, payload: bytes) -> bytes:
    """Return a package."""
    return struct.pack("!Hc", 3 + len(payload), kind.encode()) + payload


def text_message(text: str, source: str, level: int) -> bytes:
    """Return a message of protocol 2."""
    body, origin = text.encode()[:255], source.encode()[:255]
    return framed("M", bytes([len(body)]) + body + bytes([len(origin)]) + origin + bytes([level]))


def pack_values(types: list[str], values: list[Any]) -> bytes:
    """Return values one behind the other."""
    packed = b""
    for kind, value in zip(types, values, strict=True):
        code, count = _WIDTHS[kind]
        packed += struct.pack(f"!{count}{code}", *(value if count > 1 else [value]))
    return packed


def unpack_values(types: list[str], data: bytes) -> list[Any] | None:
    """Return the values of a payload; None if it has another length."""
    layout = "!" + "".join(f"{_WIDTHS[kind][1]}{_WIDTHS[kind][0]}" for kind in types)
    if struct.calcsize(layout) != len(data):
        return None
    flat = list(struct.unpack(layout, data))
    values: list[Any] = []
    for kind in types:
        count = _WIDTHS[kind][1]
        taken, flat = flat[:count], flat[count:]
        values.append(taken[0] if count == 1 else taken)
    return values


@dataclass
class Session:
    """One client of the RTDE port.

    Attributes
    ----------
    owned
        Inputs that any client writes, over all sessions: name -> session.
    write
        Told what this client writes to an input.
    """

    faults: Faults
    log: EmulatorLog
    version: tuple[int, int, int, int]
    known: Callable[[], Values]
    owned: dict[str, "Session"]
    write: Callable[[str, Any], None]
    protocol: int = 1
    started: bool = False
    rate_hz: float = 125.0
    names: list[str] = field(default_factory=list)
    types: list[str] = field(default_factory=list)
    inputs: dict[int, tuple[list[str], list[str]]] = field(default_factory=dict)
    _rest: bytes = b""

    @property
    def most_hz(self) -> float:
        """Rate of the control cycle: 125 Hz on a CB3, 500 Hz on an e-Series."""
        return 500.0 if self.version[0] >= 5 else 125.0

    def feed(self, data: bytes) -> list[bytes] | None:
        """Take what the client sent and return the replies; None if it talks nonsense and has to be dropped."""
        self._rest += data
        replies: list[bytes] = []
        while len(self._rest) >= 3:
            size, kind = struct.unpack("!Hc", self._rest[:3])
            if size < 3:
                return None
            if len(self._rest) < size:
                break
            payload, self._rest = self._rest[3:size], self._rest[size:]
            reply = self._reply(kind.decode("latin-1"), payload)
            if reply is not None:
                replies.append(reply)
        return replies

    def data(self, values: Values) -> bytes:
        """Return the data package of these values."""
        number = b"\x01" if self.protocol == 2 else b""
        return framed("U", number + pack_values(self.types, [values[name][1] for name in self.names]))

    def leave(self) -> None:
        """Give up all inputs."""
        for name in [name for name, owner in self.owned.items() if owner is self]:
            del self.owned[name]

    def _reply(self, kind: str, payload: bytes) -> bytes | None:
        answers = {
            "V": self._negotiate,
            "v": lambda _: framed("v", struct.pack("!4I", *self.version)),
            "O": self._set_outputs,
            "I": self._set_inputs,
            "S": self._start,
            "P": self._pause,
        }
        if kind == "U":
            self._take(payload)
        return answers[kind](payload) if kind in answers else None

    def _start(self, _: bytes) -> bytes:
        self.started = bool(self.names)
        return framed("S", b"\x01" if self.started else b"\x00")

    def _pause(self, _: bytes) -> bytes:
        self.started = False
        return framed("P", b"\x01")

    def _negotiate(self, payload: bytes) -> bytes:
        wanted = struct.unpack("!H", payload)[0] if len(payload) == 2 else 0
        agreed = wanted == 1 or (wanted == 2 and not self.faults.active("no-v2"))
        if agreed:
            self.protocol = wanted
        return framed("V", b"\x01" if agreed else b"\x00")

    def _set_outputs(self, payload: bytes) -> bytes:
        rate = self.most_hz
        if self.protocol == 2:
            if len(payload) < 8:
                return framed("O", b"\x00")
            rate, payload = struct.unpack("!d", payload[:8])[0], payload[8:]
            rate = min(max(rate, 1.0), self.most_hz) if math.isfinite(rate) else self.most_hz
        known = self.known()
        hidden = str(self.faults.value("not-found") or "").split(",")
        names = _names(payload)
        types = [known[n][0] if n in known and n not in hidden else "NOT_FOUND" for n in names]
        good = bool(names) and "NOT_FOUND" not in types
        if good:
            self.names, self.types, self.rate_hz = names, types, rate
        number = b"" if self.protocol == 1 else b"\x01" if good else b"\x00"
        return framed("O", number + ",".join(types).encode())

    def _set_inputs(self, payload: bytes) -> bytes:
        names = _names(payload)
        types = [self._input_type(name) for name in names]
        good = bool(names) and not {"NOT_FOUND", "IN_USE"} & set(types)
        number = len(self.inputs) + 1 if good and len(self.inputs) < 254 else 0
        if number:
            self.inputs[number] = (names, types)
            self.owned.update(dict.fromkeys(names, self))
        return framed("I", bytes([number]) + ",".join(types).encode())

    def _input_type(self, name: str) -> str:
        for pattern, kind in _INPUTS:
            if pattern.fullmatch(name):
                taken = self.faults.active("in-use") or self.owned.get(name, self) is not self
                return "IN_USE" if taken else kind
        return "NOT_FOUND"

    def _take(self, payload: bytes) -> None:
        recipe = self.inputs.get(payload[0]) if payload else None
        values = unpack_values(recipe[1], payload[1:]) if recipe else None
        if recipe is None or values is None:
            self.log.note("rejected", payload=payload[:64])
            return
        for name, value in zip(recipe[0], values, strict=True):
            self.write(name, value)


def _names(payload: bytes) -> list[str]:
    """Return the names of a request; one client in use ends them with a comma."""
    return [name for name in payload.decode("ascii", errors="replace").split(",") if name]
