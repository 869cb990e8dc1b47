"""RTDE: packages of a size, a type and a payload, all big-endian; a client agrees on what to stream, and hears it."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from labrun.devices import Clock, DeviceError
from labrun_plugins.ur5.connection import REOPEN_HINT, Connection
from labrun_plugins.ur5.settings import Ur5Settings
from labrun_plugins.ur5.state import OPTIONAL, REQUIRED

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
    return "".join(character if character.isprintable() else " " for character in line).strip()[:200]


def _joined(names: tuple[str, ...]) -> bytes:
    joined = ",".join(names).encode("ascii")
    if len(joined) > MOST_NAMES:
        raise ValueError(f"{len(joined)} bytes of names; the controller takes {MOST_NAMES}")
    return joined


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
        unknown = [kind for kind in types if kind not in _FORMATS]
        if unknown:
            raise ValueError(f"unknown type {unknown[0][:40]!r}")
        self.number = number
        self.names = tuple(names)
        self.types = tuple(types)
        formats = [_FORMATS[kind] for kind in types]
        self._struct = struct.Struct(">" + ("" if number is None else "B") + "".join(formats))
        self._places: dict[str, tuple[int, int]] = {}
        first = 0 if number is None else 1
        for name, form in zip(names, formats, strict=True):
            width = int(form[:-1] or 1)
            self._places[name] = (first, width)
            first += width

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
            name: flat[index] if width == 1 else flat[index : index + width]
            for name, (index, width) in self._places.items()
        }

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """Return the payload of a data package with these values."""
        flat: list[Any] = [] if self.number is None else [self.number]
        for name, (_, width) in self._places.items():
            flat += [values[name]] if width == 1 else list(values[name])
        return self._struct.pack(*flat)


CB3_HZ, E_SERIES_HZ = 125.0, 500.0
_ANSWER_S = 2.0
_CB3 = 3
_TEXTS = 20


class RtdeClient:
    """One connection to the RTDE port.

    Parameters
    ----------
    clock
        Host time.

    Attributes
    ----------
    protocol
        2, or 1 where the controller refuses that.
    version
        Of the controller: major, minor, bugfix, build.
    rate_hz
        Of the stream.
    missing
        Optional variables the controller does not have.
    texts
        The last messages of the controller.
    """

    def __init__(self, device: str, settings: Ur5Settings, clock: Clock) -> None:
        self._device = device
        self._settings = settings
        self._clock = clock
        self._connection = Connection(
            device, "RTDE service", settings.host, settings.rtde_port, settings.interface
        )
        self._stream = PackageStream()
        self._waiting: list[Package] = []
        self._outputs = Recipe(None, (), ())
        self._inputs: Recipe | None = None
        self._beats = 0
        self.register = f"input_int_register_{settings.watchdog_register}"
        self.protocol = 2
        self.version = (0, 0, 0, 0)
        self.rate_hz = CB3_HZ
        self.missing: tuple[str, ...] = ()
        self.texts: list[Text] = []

    def open(self) -> None:
        """Connect, agree, and start the stream.

        Raises DeviceError: not reached, no or a wrong answer, a variable that the controller lacks, or a register that
        is taken.
        """
        self._connection.open()
        self._stream = PackageStream()
        self._waiting = []
        self.texts = []
        try:
            self._agree()
        except DeviceError:
            self._connection.close()
            raise

    def receive(self) -> tuple[list[Mapping[str, Any]], float]:
        """Return the data packages that have arrived, waiting briefly for the first, and the host's time of receipt.

        Raises DeviceError: the connection is lost, or what arrives is no data of this stream.
        """
        data = self._connection.read() if not self._waiting else b""
        host_s = self._clock.now()
        samples: list[Mapping[str, Any]] = []
        for package in [*self._take_waiting(), *self._cut(data)]:
            if package.kind == DATA:
                values = self._outputs.decode(package.payload)
                if values is None:
                    raise self._lost_its_way(
                        f"a data package of {len(package.payload)} bytes where recipe {self._outputs.number} has "
                        f"{self._outputs.size}"
                    )
                samples.append(values)
            elif package.kind == TEXT:
                self._note(package.payload)
        return samples, host_s

    def beat(self) -> None:
        """Refresh the watchdog's register; DeviceError if the connection is lost."""
        if self._inputs is None:
            return
        self._beats = (self._beats + 1) % 1_000_000
        self._connection.write(encode(DATA, self._inputs.encode({self.register: self._beats})))

    def close(self) -> None:
        """Disconnect; harmless when not connected."""
        self._connection.close()
        self._inputs = None

    def _agree(self) -> None:
        self.protocol = 2
        if not accepted(self._ask(protocol_request(2), VERSION_REQUEST)):
            self.protocol = 1
            if not accepted(self._ask(protocol_request(1), VERSION_REQUEST)):
                raise DeviceError(
                    self._device, "refuses versions 2 and 1 of RTDE", hint="update the controller's PolyScope"
                )
        version = controller_version(self._ask(encode(CONTROLLER_VERSION), CONTROLLER_VERSION))
        if version is None:
            raise self._lost_its_way("an answer without the controller's version")
        self.version = version
        most_hz = CB3_HZ if version[0] <= _CB3 else E_SERIES_HZ
        self.rate_hz = most_hz
        if self.protocol == 2 and self._settings.rate_hz is not None:
            self.rate_hz = min(most_hz, self._settings.rate_hz)
        self._agree_on_outputs()
        self._agree_on_inputs()
        if not accepted(self._ask(encode(START), START)):
            raise DeviceError(self._device, "refuses to start its RTDE stream", hint="restart the controller")

    def _agree_on_outputs(self) -> None:
        names: tuple[str, ...] = REQUIRED + OPTIONAL
        number, types = self._request_outputs(names)
        lacking = [name for name, kind in zip(names, types, strict=False) if kind == NOT_FOUND]
        needed = [name for name in lacking if name in REQUIRED]
        if needed:
            raise DeviceError(
                self._device,
                f"its controller ({self.version_text}) does not know {', '.join(needed)}",
                hint="update PolyScope: 3.10 or newer on CB3, 5.4 or newer on e-Series",
            )
        if lacking:
            names = tuple(name for name in names if name not in lacking)
            number, types = self._request_outputs(names)
        self.missing = tuple(lacking)
        self._outputs = self._recipe(number if self.protocol == 2 else None, names, types)

    def _request_outputs(self, names: tuple[str, ...]) -> tuple[int, tuple[str, ...]]:
        rate = self.rate_hz if self.protocol == 2 else None
        reply = self._ask(outputs_request(names, rate), OUTPUTS)
        return types_of(reply, with_recipe=self.protocol == 2)

    def _agree_on_inputs(self) -> None:
        names = (self.register,)
        number, types = types_of(self._ask(inputs_request(names), INPUTS), with_recipe=True)
        if IN_USE in types:
            raise DeviceError(
                self._device,
                f"another program owns {self.register}, which labrun's watchdog needs",
                hint="end that program (another labrun, ur_rtde, a ROS driver, a fieldbus), or set watchdog_register "
                "to another number from 24 to 47",
            )
        if NOT_FOUND in types:
            raise DeviceError(
                self._device,
                f"its controller has no {self.register}",
                hint="set watchdog_register to a number from 0 to 23, which older software has too",
            )
        self._inputs = self._recipe(number, names, types)

    def _recipe(self, number: int | None, names: tuple[str, ...], types: tuple[str, ...]) -> Recipe:
        if number == 0:
            raise self._lost_its_way(f"a refusal of {', '.join(names)}: {', '.join(types)}")
        try:
            return Recipe(number, names, types)
        except ValueError as error:
            raise self._lost_its_way(str(error)) from None

    def _ask(self, request: bytes, kind: int) -> bytes:
        """Send a request, and return the payload of its reply; what else arrives meanwhile is kept or noted."""
        self._connection.write(request)
        deadline_s = self._clock.now() + _ANSWER_S
        while self._clock.now() < deadline_s:
            arrived = self._take_waiting() + self._cut(self._connection.read())
            for number, package in enumerate(arrived):
                if package.kind == kind:
                    self._waiting = arrived[number + 1 :]
                    return package.payload
                if package.kind == TEXT:
                    self._note(package.payload)
        raise DeviceError(
            self._device,
            f"does not answer at its RTDE service (request {chr(kind)!r}, {_ANSWER_S:g} s)",
            hint="is this address a UR controller, and is it past booting? Look at the pendant",
        )

    def _cut(self, data: bytes) -> list[Package]:
        arrived = self._stream.feed(data)
        if self._stream.broken and not arrived:
            raise self._lost_its_way(self._stream.broken)
        return arrived

    def _take_waiting(self) -> list[Package]:
        waiting, self._waiting = self._waiting, []
        return waiting

    def _note(self, payload: bytes) -> None:
        if self.protocol == 2 and (text := text_of(payload)) is not None:
            self.texts = [*self.texts[-_TEXTS:], text]

    def _lost_its_way(self, what: str) -> DeviceError:
        return DeviceError(self._device, f"its RTDE service sent {what}", hint=REOPEN_HINT)

    @property
    def version_text(self) -> str:
        """Version of the controller, as on its pendant."""
        return ".".join(str(part) for part in self.version)
