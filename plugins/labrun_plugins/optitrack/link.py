"""Datagrams to and from the server, and from nobody else, over sockets on one named interface."""

import contextlib
import ipaddress
import select
import socket
import struct
import sys
from dataclasses import dataclass

from labrun.devices import Clock, DeviceError
from labrun_plugins.optitrack.messages import split

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

    Raises
    ------
    DeviceError
        There is no such interface, or no way to the address.
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
    device
        Its name in the experiment file.
    clock
        Gives the times of arrival.
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
        """Send one datagram to the server.

        Raises
        ------
        DeviceError
            Not connected, or the network is gone.
        """
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
        for one in ready:
            for _ in range(_AT_ONCE):
                try:
                    datagram, (sender, _port) = one.recvfrom(_MOST)
                except BlockingIOError:
                    break
                except (
                    ConnectionError
                ):  # nobody listens at the server's port; who needs an answer will notice
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
        for one in sockets:
            with contextlib.suppress(OSError):
                one.close()
