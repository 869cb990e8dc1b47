"""Where emulators are reached: a pty in place of a serial port, UDP and TCP sockets on loopback."""

import contextlib
import errno
import math
import os
import pty
import socket
import tty
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from labrun.devices.clock import Clock
from labrun.devices.emulation import EmulatorContext, Faults

Target = TypeVar("Target", bound=Hashable)

_BYTE_S = 0.0005
"""Between two bytes of a message that comes in pieces."""


@dataclass
class FaultyWire(Generic[Target]):
    """A queue of messages under way, each with the time at which it arrives.

    Faults it knows: silence, late (s), fragment (each byte alone), coalesce (this many messages at once), corrupt (one
    bit of this many messages), half-frame (this many cut in the middle), truncate (this many short of their last
    byte), drop (share), duplicate and reorder (this many).

    Parameters
    ----------
    baud
        Bits a second of the wire, ten to a byte: a message arrives when its last byte has; None for no such delay.

    Attributes
    ----------
    arrived
        Messages that have come to the end of the wire so far.
    """

    clock: Clock
    rng: np.random.Generator
    faults: Faults
    baud: float | None = None
    arrived: int = 0
    _under_way: deque[tuple[float, bytes, Target]] = field(default_factory=deque)
    _free_s: float = -math.inf
    _held: tuple[bytes, Target] | None = None
    _gathered: list[tuple[bytes, Target]] = field(default_factory=list)

    def put(self, message: bytes, target: Target) -> None:
        """Send a message on its way, or not, as the faults of the moment have it."""
        faults = self.faults
        if faults.active("silence") or self.rng.random() < faults.number("drop"):
            return
        if faults.take("corrupt"):
            message = self._with_a_bit_flipped(message)
        if faults.take("half-frame"):
            message = message[: len(message) // 2]
        if faults.take("truncate"):
            message = message[:-1]
        if faults.active("coalesce"):
            self._gathered.append((message, target))
            if len(self._gathered) < faults.number("coalesce"):
                return
            message = b"".join(part for part, _ in self._gathered)
            self._gathered.clear()
        if self._held is None and faults.take("reorder"):
            self._held = (message, target)
            return
        self._send(message, target)
        if self._held is not None:
            self._send(*self._held)
            self._held = None
        if faults.take("duplicate"):
            self._send(message, target)

    def due(self, now_s: float) -> list[tuple[bytes, Target]]:
        """Return what arrives up to now."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= now_s:
            _, message, target = self._under_way.popleft()
            self.arrived += 1
            arrived.append((message, target))
        return arrived

    def next_s(self) -> float:
        """Return when the next message arrives; infinite if none is under way."""
        return self._under_way[0][0] if self._under_way else math.inf

    def clear(self) -> None:
        """Lose everything under way."""
        self._under_way.clear()
        self._gathered.clear()
        self._held = None

    def _send(self, message: bytes, target: Target) -> None:
        begin_s = max(self.clock.now() + self.faults.number("late"), self._free_s)
        byte_s = 0.0 if self.baud is None else 10.0 / self.baud
        if self.faults.active("fragment"):
            for number in range(len(message)):
                begin_s += max(byte_s, _BYTE_S)
                self._under_way.append((begin_s, message[number : number + 1], target))
            self._free_s = begin_s
            return
        self._free_s = begin_s + byte_s * len(message)
        self._under_way.append((self._free_s, message, target))

    def _with_a_bit_flipped(self, message: bytes) -> bytes:
        if not message:
            return message
        bit = int(self.rng.integers(8 * len(message)))
        flipped = bytearray(message)
        flipped[bit // 8] ^= 1 << (bit % 8)
        return bytes(flipped)


_MOST = 65_536
_UDP_BUFFER = 4 << 20


class PtyEndpoint:
    """The far end of a serial port.

    The fault ``unplug`` closes it, as pulling the plug does; when the fault ends it is back under the same path.

    Parameters
    ----------
    name
        Of the link in the context's folder.
    baud
        Paces what is sent; a pty itself knows no speed.
    """

    def __init__(self, context: EmulatorContext, name: str, baud: float | None = None) -> None:
        self._faults = context.faults
        self._log = context.log
        self._wire: FaultyWire[None] = FaultyWire(context.clock, context.rng, context.faults, baud)
        self.path = context.folder / name
        self._master = -1
        self._slave = -1

    def open(self) -> str:
        """Open it, and return the path by which a driver opens it."""
        self._plug()
        return str(self.path)

    @property
    def fds(self) -> list[int]:
        """What to wait on; nothing while it is unplugged."""
        return [self._master] if self._master >= 0 else []

    def receive(self) -> bytes:
        """Return what the driver has sent; minds whether it is plugged in."""
        if self._faults.active("unplug"):
            self._unplug()
            return b""
        if self._master < 0:
            self._plug()
        with contextlib.suppress(BlockingIOError):
            try:
                return os.read(self._master, _MOST)
            except OSError as error:
                if error.errno != errno.EIO:
                    raise
        return b""

    def send(self, message: bytes) -> None:
        """Send one message; it leaves with `flush`."""
        self._wire.put(message, None)

    def flush(self, now_s: float) -> float:
        """Put on the line what is due by now; return when the next message is."""
        for message, _ in self._wire.due(now_s):
            if self._master >= 0:
                # nobody reads: the line's buffer is full, bytes are lost
                with contextlib.suppress(BlockingIOError):
                    os.write(self._master, message)
        return self._wire.next_s()

    def close(self) -> None:
        """Close it and take its link away; the log gets the number of messages sent."""
        self._unplug()
        self._log.note("closed", path=str(self.path), sent=self._wire.arrived)

    def _plug(self) -> None:
        self._master, self._slave = pty.openpty()
        for end in (self._master, self._slave):  # before any byte flows, or echo and CR/LF would spoil it
            tty.setraw(end)
        os.set_blocking(self._master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))
        self._log.note("plugged", path=str(self.path))

    def _unplug(self) -> None:
        if self._master < 0:
            return
        self._wire.clear()
        self.path.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1
        self._log.note("unplugged", path=str(self.path))


Address = tuple[str, int]


class UdpEndpoint:
    """A UDP socket on loopback.

    Parameters
    ----------
    host, port
        Where it listens; port 0 takes a free one.
    """

    def __init__(self, context: EmulatorContext, host: str = "127.0.0.1", port: int = 0) -> None:
        self._wire: FaultyWire[Address] = FaultyWire(context.clock, context.rng, context.faults)
        self._log = context.log
        self._address = (host, port)
        self.socket: socket.socket | None = None

    def open(self) -> int:
        """Open it, and return its port."""
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UDP_BUFFER)
        self.socket.bind(self._address)
        self.socket.setblocking(False)
        return int(self.socket.getsockname()[1])

    @property
    def fds(self) -> list[int]:
        """What to wait on."""
        return [self.socket.fileno()] if self.socket is not None else []

    def receive(self) -> list[tuple[bytes, Address]]:
        """Return the datagrams that arrived, and where each came from."""
        arrived: list[tuple[bytes, Address]] = []
        while self.socket is not None:
            try:
                message, address = self.socket.recvfrom(_MOST)
            except BlockingIOError:
                break
            except ConnectionError:  # an earlier datagram of ours found nobody: no reason to stop
                continue
            arrived.append((message, (str(address[0]), int(address[1]))))
        return arrived

    def send(self, message: bytes, address: Address) -> None:
        """Send one datagram; it leaves with `flush`."""
        self._wire.put(message, address)

    def flush(self, now_s: float) -> float:
        """Send what is due by now; return when the next datagram is."""
        for message, address in self._wire.due(now_s):
            if self.socket is not None:
                # datagrams get lost; that nobody listens is no fault of a sender
                with contextlib.suppress(OSError):
                    self.socket.sendto(message, address)
        return self._wire.next_s()

    def close(self) -> None:
        """Close it; the log gets the number of datagrams sent."""
        if self.socket is not None:
            self._log.note("closed", udp=self.socket.getsockname()[1], sent=self._wire.arrived)
            self.socket.close()
            self.socket = None


class TcpEndpoint:
    """A TCP server on loopback with any number of clients.

    Parameters
    ----------
    host, port
        Where it listens; port 0 takes a free one.
    """

    def __init__(self, context: EmulatorContext, host: str = "127.0.0.1", port: int = 0) -> None:
        self._wire: FaultyWire[int] = FaultyWire(context.clock, context.rng, context.faults)
        self._log = context.log
        self._address = (host, port)
        self._server: socket.socket | None = None
        self._clients: dict[int, socket.socket] = {}
        self._numbered = 0

    def open(self) -> int:
        """Open it, and return its port."""
        self._server = socket.create_server(self._address)
        self._server.setblocking(False)
        return int(self._server.getsockname()[1])

    @property
    def fds(self) -> list[int]:
        """What to wait on: the server and every client."""
        server = [self._server.fileno()] if self._server is not None else []
        return server + [client.fileno() for client in self._clients.values()]

    @property
    def clients(self) -> list[int]:
        """The numbers of the clients that are connected."""
        return list(self._clients)

    def accept(self) -> list[int]:
        """Take new clients; return their numbers."""
        connections: list[int] = []
        while self._server is not None:
            try:
                client, _ = self._server.accept()
            except BlockingIOError:
                break
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._numbered += 1
            self._clients[self._numbered] = client
            connections.append(self._numbered)
        return connections

    def receive(self) -> list[tuple[int, bytes]]:
        """Return what clients have sent since the last time; empty bytes stand for a client that has left."""
        arrived: list[tuple[int, bytes]] = []
        for number, client in list(self._clients.items()):
            try:
                data = client.recv(_MOST)
            except BlockingIOError:
                continue
            except ConnectionError:
                data = b""
            if not data:
                self.drop(number)
            arrived.append((number, data))
        return arrived

    def send(self, client: int, message: bytes) -> None:
        """Send one message; it leaves with `flush`."""
        self._wire.put(message, client)

    def flush(self, now_s: float) -> float:
        """Send what is due by now; return when the next message is."""
        for message, number in self._wire.due(now_s):
            client = self._clients.get(number)
            if client is None:
                continue
            try:
                client.sendall(message)
            except OSError:  # it has left, or reads nothing any more: a server drops such a client
                self.drop(number)
        return self._wire.next_s()

    def drop(self, client: int, *, reset: bool = False) -> None:
        """Close one client's connection; with `reset` as a crash does."""
        connection = self._clients.pop(client, None)
        if connection is None:
            return
        if reset:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
        connection.close()

    def close(self) -> None:
        """Close everything; the log gets the number of messages sent."""
        for client in self.clients:
            self.drop(client)
        if self._server is not None:
            self._log.note("closed", tcp=self._server.getsockname()[1], sent=self._wire.arrived)
            self._server.close()
            self._server = None
