"""Datagrams to and from the server, and from nobody else."""

import contextlib
import select
import socket
from dataclasses import dataclass

from labrun.devices import Clock, DeviceError
from labrun_plugins.optitrack.messages import split
from labrun_plugins.optitrack.sockets import open_command, open_multicast

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
