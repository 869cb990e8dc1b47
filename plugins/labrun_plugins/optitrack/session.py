"""A session with the server: datagrams to and from it alone, its layout and bodies, what keeps it streaming."""

import contextlib
import ipaddress
import select
import socket
import struct
import sys
from collections import deque
from dataclasses import dataclass

from labrun.devices import Clock, DeviceError
from labrun_plugins.optitrack.frame import Frame, decode_frame
from labrun_plugins.optitrack.messages import (
    MessageId,
    ServerInfo,
    Version,
    connect,
    dotted,
    echo_request,
    echo_ticks,
    encode,
    server_info,
    split,
)
from labrun_plugins.optitrack.model import BodyModel, decode_model
from labrun_plugins.optitrack.settings import OptiTrackSettings

_RECEIVE_BUFFER = 4 << 20
_SIOCGIFADDR = 0x8915
_IP_MULTICAST_ALL = getattr(socket, "IP_MULTICAST_ALL", 49)


def host_address(device: str, host: str) -> str:
    """Return the IPv4 address of a host; DeviceError if it has none."""
    try:
        return socket.gethostbyname(host)
    except (OSError, UnicodeError) as error:
        raise DeviceError(
            device,
            f"host {host!r} has no address: {error}",
            hint="give the IPv4 address of the computer that runs Motive as host",
        ) from error


def local_address(device: str, address: str, interface: str) -> str:
    """Return the address of this computer's interface: the named one, else the one that routes to `address`.

    Raises DeviceError: there is no such interface, or no way to the address.
    """
    if interface:
        with contextlib.suppress(ValueError):
            return str(ipaddress.IPv4Address(interface))
        return _address_of(device, interface)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((address, 9))  # sends nothing: only asks for the route
            return str(probe.getsockname()[0])
        except OSError as error:
            raise DeviceError(
                device,
                f"no network interface leads to {address}: {error.strerror}",
                hint="connect this computer to Motive's network; check with: ping " + address,
            ) from error


def open_command(device: str, local: str) -> socket.socket:
    """Return a socket for requests, and for frames sent to this computer alone; bound to the interface."""
    return _bound(device, local, 0, local)


def open_multicast(device: str, local: str, group: str, port: int) -> socket.socket:
    """Return a socket for the frames of a multicast group, joined on one interface.

    On Linux and macOS a socket that is bound to the interface's own address gets no multicast: it must be bound to the
    address of the group, and the interface is chosen by the membership alone. There, other programs' memberships
    would count as well, were it not for IP_MULTICAST_ALL. Windows knows no binding to a group: there it is the
    interface's address. None of them needs 0.0.0.0.

    Raises
    ------
    DeviceError
        Not a multicast group, a port in use, or an interface without multicast.
    """
    if not ipaddress.IPv4Address(group).is_multicast:
        raise DeviceError(
            device,
            f"{group} is not a multicast group",
            hint="see Multicast Interface in Motive's streaming pane",
        )
    bound_to = local if sys.platform == "win32" else group
    opened = _bound(device, bound_to, port, local, shared=True)
    try:
        if sys.platform == "linux":
            opened.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        membership = struct.pack("=4s4s", socket.inet_aton(group), socket.inet_aton(local))
        opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    except OSError as error:
        opened.close()
        raise DeviceError(
            device,
            f"multicast group {group} cannot be joined on interface {local}: {error.strerror}",
            hint="name the interface that leads to Motive (interface), or stream unicast",
        ) from error
    return opened


def _bound(device: str, address: str, port: int, local: str, *, shared: bool = False) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if shared:  # several programs of one computer may listen to a group
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):  # as much as the system grants
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        opened.bind((address, port))
        opened.setblocking(False)
    except OSError as error:
        opened.close()
        raise DeviceError(
            device,
            f"cannot listen on {address}:{port}: {error.strerror}",
            hint=f"this computer's interfaces do not include {local}, or another program holds the port alone",
        ) from error
    return opened


def _address_of(device: str, interface: str) -> str:
    """Return the address of an interface by its name, as Linux tells it."""
    try:
        import fcntl

        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            asked = struct.pack("256s", interface.encode()[:15])
            return socket.inet_ntoa(fcntl.ioctl(probe.fileno(), _SIOCGIFADDR, asked)[20:24])
    except (ImportError, OSError) as error:
        names = ", ".join(name for _, name in socket.if_nameindex())
        raise DeviceError(
            device,
            f"interface {interface!r} is not one of this computer's, or has no IPv4 address",
            hint=f"give its IPv4 address or one of: {names}",
        ) from error


_PATIENCE_S = 0.02
_MOST = 65_536
_AT_ONCE = 64
"""Datagrams taken from a socket before the other one gets its turn."""


@dataclass(frozen=True, slots=True)
class Heard:
    """A message of the server, and when it arrived."""

    message: int
    payload: bytes
    host_s: float


class Link:
    """The sockets of a session.

    Parameters
    ----------
    server, port
        IPv4 address of the server, and its command port.
    local
        Address of this computer's interface.

    Attributes
    ----------
    foreign
        Datagrams of others, dropped; `foreign_address` sent the last of them.
    malformed
        Datagrams shorter than they say.
    """

    def __init__(self, device: str, clock: Clock, server: str, port: int, local: str) -> None:
        self._device = device
        self._clock = clock
        self._address = (server, port)
        self._local = local
        self._sockets: list[socket.socket] = []
        self.foreign = 0
        self.foreign_address = ""
        self.malformed = 0

    def open(self) -> None:
        """Open the command socket."""
        self._sockets = [open_command(self._device, self._local)]

    def join(self, group: str, port: int) -> None:
        """Listen to a multicast group as well."""
        self._sockets.append(open_multicast(self._device, self._local, group, port))

    def send(self, datagram: bytes) -> None:
        """Send one datagram to the server. Raises DeviceError: not connected, or the network is gone."""
        if not self._sockets:
            raise DeviceError(self._device, "is not open", hint="open() comes before any other call")
        try:
            self._sockets[0].sendto(datagram, self._address)
        except (BlockingIOError, ConnectionError):
            pass  # a datagram may get lost; who needs an answer asks again
        except OSError as error:
            raise DeviceError(
                self._device,
                f"nothing can be sent to {self._address[0]}: {error.strerror}",
                hint="check the network cable and interface " + self._local,
            ) from error

    def receive(self) -> list[Heard]:
        """Return what has arrived; waits a few hundredths of a second for the first datagram."""
        sockets = list(self._sockets)
        if not sockets:
            return []
        ready, _, _ = select.select(sockets, [], [], _PATIENCE_S)
        heard: list[Heard] = []
        for endpoint in ready:
            for _ in range(_AT_ONCE):
                try:
                    datagram, (sender, _port) = endpoint.recvfrom(_MOST)
                except BlockingIOError:
                    break
                # nobody listens at the server's port; who needs an answer will notice
                except ConnectionError:
                    continue
                host_s = self._clock.now()
                if sender != self._address[0]:
                    self.foreign += 1
                    self.foreign_address = str(sender)
                    continue
                message = split(datagram)
                if message is None:
                    self.malformed += 1
                else:
                    heard.append(Heard(*message, host_s))
        return heard

    def close(self) -> None:
        """Close all sockets; harmless when closed."""
        sockets, self._sockets = self._sockets, []
        for open_socket in sockets:
            with contextlib.suppress(OSError):
                open_socket.close()


_KEPT = 60
_NS = 1e9


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Server's time minus the host's, s, and the round trip it was measured over; it is off by half of that at most."""

    offset_s: float
    round_trip_s: float


class Echoes:
    """Keeps the last answers; the one with the shortest way tells most."""

    def __init__(self) -> None:
        self._answers: deque[ClockOffset] = deque(maxlen=_KEPT)

    def __len__(self) -> int:
        return len(self._answers)

    @staticmethod
    def ticks(now_s: float) -> int:
        """Return what is sent along with a question: the host's time in ns."""
        return int(now_s * _NS)

    def answered(self, own_ticks: int, server_ticks: int, clock_hz: int, now_s: float) -> None:
        """Take an answer; one that says it was asked in the future, or long ago, is none."""
        asked_s = own_ticks / _NS
        if not 0.0 <= now_s - asked_s <= 1.0:
            return
        offset_s = server_ticks / clock_hz - 0.5 * (asked_s + now_s)
        self._answers.append(ClockOffset(offset_s, now_s - asked_s))

    def best(self) -> ClockOffset | None:
        """Return the answer with the shortest round trip; None if there is none."""
        return min(self._answers, key=lambda answer: answer.round_trip_s, default=None)


NEWEST: Version = (4, 2)
_EVERY_S = 1.0
"""Between two signs of life, and between two questions for the clock."""
_FIRST_ECHOES, _FIRST_EVERY_S = 10, 0.1
"""The first questions for the clock come faster: the quickest answer of several is worth having early."""
_AGAIN_S = 0.1
_DOUBT_S = 1.0


class Session:
    """Talks to one server.

    Attributes
    ----------
    info, layout, multicast, rate_hz, bodies
        What the server said: who it is, the layout of its frames, how they come, camera rate (None if it does not say),
        and the bodies it streams.
    models
        How often the bodies were told.
    unreadable
        Frames that do not fit the layout; `unreadable_in_a_row` since the last that did, `sample` the last one.
    answered_s
        When the server last said anything but a frame.
    response, refused
        The last answer to a command, and whether one was refused; for who asks.
    """

    def __init__(self, device: str, settings: OptiTrackSettings, clock: Clock) -> None:
        self._device = device
        self._settings = settings
        self._clock = clock
        self.info: ServerInfo | None = None
        self.layout: Version = NEWEST
        self.multicast = False
        self.rate_hz: float | None = None
        self.bodies: tuple[BodyModel, ...] = ()
        self.models = 0
        self.unreadable = 0
        self.unreadable_in_a_row = 0
        self.sample = b""
        self.answered_s = -float("inf")
        self.echoes = Echoes()
        self.response: bytes | None = None
        self.refused = False
        self._doubts: dict[str, float] = {}
        self._due_s = 0.0
        self._echo_s = 0.0
        self._again_s = 0.0
        server = host_address(device, settings.host)
        self.local = local_address(device, server, settings.interface)
        self.link = Link(device, clock, server, settings.command_port, self.local)

    def pump(self) -> list[tuple[Frame, float]]:
        """Take what has arrived, keep the session alive, and return the frames with their times of arrival.

        Raises DeviceError: the server is no longer the one that was connected to.
        """
        frames: list[tuple[Frame, float]] = []
        for heard in self.link.receive():
            if heard.message == MessageId.FRAMEOFDATA:
                frame = decode_frame(heard.payload, self.layout, with_markers=bool(self._settings.markers))
                if frame is None:
                    self.unreadable += 1
                    self.unreadable_in_a_row += 1
                    self.sample = heard.payload
                else:
                    self.unreadable_in_a_row = 0
                    frames.append((frame, heard.host_s))
            else:
                self._mind(heard)
        self._keep_alive()
        return frames

    def exposed_s(self, frame: Frame) -> float:
        """Return when a frame was exposed, s by the server's clock; before NatNet 3 by Motive's software clock."""
        clock_hz = None if self.info is None else self.info.clock_hz
        if clock_hz is None or frame.exposed is None:
            return frame.timestamp_s
        return frame.exposed / clock_hz

    def latency_s(self, frame: Frame) -> float | None:
        """Return how long a frame took inside Motive, s; None before NatNet 3."""
        clock_hz = None if self.info is None else self.info.clock_hz
        if clock_hz is None or frame.exposed is None or frame.sent is None:
            return None
        return (frame.sent - frame.exposed) / clock_hz

    def doubt(self, *what: str) -> None:
        """Ask anew for the "model" or the "server"; until the answer is there, `in_doubt` says so."""
        now_s = self._clock.now()
        for name in what:
            self._doubts.setdefault(name, now_s)
        self._again_s = now_s

    @property
    def in_doubt(self) -> bool:
        """Tell whether it is open who streams, or which bodies the numbers in the frames stand for."""
        return bool(self._doubts)

    def doubtful_for_s(self) -> float:
        """Return for how long the oldest open question has had no answer, s."""
        return self._clock.now() - min(self._doubts.values(), default=self._clock.now())

    def connect_again(self) -> None:
        """Ask to be served once more: a server that was restarted has forgotten its clients."""
        self.link.send(connect())

    def close(self) -> None:
        """Say goodbye and close the sockets; harmless when closed."""
        if self.info is not None:
            self.info = None
            with contextlib.suppress(DeviceError):  # gone already
                self.link.send(encode(MessageId.DISCONNECT))
        self.link.close()

    def _mind(self, heard: Heard) -> None:
        self.answered_s = heard.host_s
        match heard.message:
            case MessageId.SERVERINFO:
                self._take_server(heard.payload)
            case MessageId.MODELDEF:
                bodies = decode_model(heard.payload, self.layout)
                if bodies is not None:
                    self.bodies = bodies
                    self.models += 1
                    self._doubts.pop("model", None)
            case MessageId.RESPONSE:
                self.response = heard.payload
            case MessageId.UNRECOGNIZED_REQUEST:
                self.refused = True
            case MessageId.ECHORESPONSE:
                ticks = echo_ticks(heard.payload)
                if ticks is not None and self.info is not None and self.info.clock_hz:
                    self.echoes.answered(*ticks, self.info.clock_hz, heard.host_s)
            case MessageId.DISCONNECTBYTIMEOUT:
                self.connect_again()
            case _:
                pass

    def _take_server(self, payload: bytes) -> None:
        info = server_info(payload)
        if info is None:
            return
        if self.info is None:
            self.info = info
        elif info != self.info:
            before = self.info
            raise DeviceError(
                self._device,
                f"is another server than before: {_told(info)}, not {_told(before)}",
                hint="Motive was restarted or its streaming pane changed; labrun resume connects again",
            )
        self._doubts.pop("server", None)

    def _keep_alive(self) -> None:
        now_s = self._clock.now()
        if self.info is None:
            return
        if now_s >= self._due_s:
            self._due_s = now_s + _EVERY_S
            if not self.multicast:
                self.link.send(encode(MessageId.KEEPALIVE))
        if self.info.clock_hz and now_s >= self._echo_s:
            self._echo_s = now_s + (_EVERY_S if len(self.echoes) >= _FIRST_ECHOES else _FIRST_EVERY_S)
            self.link.send(echo_request(Echoes.ticks(now_s)))
        if self._doubts and now_s >= self._again_s and self.doubtful_for_s() < _DOUBT_S:
            self._again_s = now_s + _AGAIN_S
            if "server" in self._doubts:
                self.connect_again()
            if "model" in self._doubts:
                self.link.send(encode(MessageId.REQUEST_MODELDEF))


def _told(info: ServerInfo) -> str:
    how = "" if info.multicast is None else f", {'multicast' if info.multicast else 'unicast'}"
    clock = "" if info.clock_hz is None else f", clock {info.clock_hz} Hz"
    return f"{info.name} {dotted(info.app)}, NatNet {dotted(info.natnet)}{clock}{how}"
