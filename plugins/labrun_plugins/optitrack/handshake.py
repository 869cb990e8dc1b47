"""The beginning of a session: who the server is, how it streams, in which layout, how fast, and what."""

from collections.abc import Callable
from typing import TypeVar

from labrun.devices import Clock, DeviceError
from labrun_plugins.optitrack.messages import (
    MessageId,
    ServerInfo,
    answered_number,
    connect,
    connect_with_version,
    dotted,
    encode,
    request,
)
from labrun_plugins.optitrack.session import NEWEST, Session
from labrun_plugins.optitrack.settings import OptiTrackSettings

_GROUP, _DATA_PORT = "239.255.42.99", 1511
_TRIES = 4
_PATIENCE_S = 0.5
_MOST_HZ = 1e5

Answer = TypeVar("Answer")


class Handshake:
    """Questions and answers before the first sample."""

    def __init__(self, device: str, settings: OptiTrackSettings, clock: Clock, session: Session) -> None:
        self._device = device
        self._settings = settings
        self._clock = clock
        self._session = session

    def perform(self) -> None:
        """Connect; afterwards the session knows all that its attributes tell.

        Raises DeviceError: no answer, or one that cannot be worked with.
        """
        self._session.link.open()
        info = self._ask(connect(), lambda: self._session.info)
        if info is None:
            where = f"{self._settings.host}:{self._settings.command_port}"
            raise DeviceError(
                self._device,
                f"no answer from Motive at {where} to interface {self._session.local}",
                hint="start Motive, switch on Broadcast Frame Data in its streaming pane, and let its computer's "
                f"firewall pass UDP; then check with: ping {self._settings.host}",
            )
        if info.version < (2, 0):
            raise DeviceError(
                self._device,
                f"speaks NatNet {dotted(info.natnet)}; labrun reads 2.0 and later",
                hint="update Motive",
            )
        if info.version >= (3, 0) and info.clock_hz is None:
            raise DeviceError(self._device, "does not say how fast its clock ticks", hint="restart Motive")
        self._choose_transmission(info)
        self._choose_layout(info)
        self._session.rate_hz = self._asked_rate()
        if self._ask(encode(MessageId.REQUEST_MODELDEF), lambda: self._session.models or None) is None:
            raise DeviceError(
                self._device,
                f"does not say which bodies it streams (NatNet {dotted(self._session.layout)})",
                hint='look at Motive\'s streaming pane; with NatNet 4 try another layout: bitstream = "4.1"',
            )

    def _choose_transmission(self, info: ServerInfo) -> None:
        wanted, stated = self._settings.transmission, info.multicast
        if wanted != "auto" and stated is not None and stated != (wanted == "multicast"):
            raise DeviceError(
                self._device,
                f'streams {"multicast" if stated else "unicast"}, and the file says transmission = "{wanted}"',
                hint="change Transmission Type in Motive's streaming pane, or transmission in the file",
            )
        self._session.multicast = stated is not False if wanted == "auto" else wanted == "multicast"
        if self._session.multicast:
            group = self._settings.group or info.group or _GROUP
            self._session.link.join(group, self._settings.data_port or info.data_port or _DATA_PORT)

    def _choose_layout(self, info: ServerInfo) -> None:
        stated = self._settings.bitstream
        major, minor = info.version if stated is None else (int(part) for part in stated.split("."))
        self._session.layout = major, minor
        if info.version < (4, 0) or self._session.multicast:
            return  # nobody can choose: what is stated is taken as how the frames are
        if stated is None:
            self._session.layout = min(self._session.layout, NEWEST)
        self._session.response = None
        answer = self._ask(
            request(f"Bitstream,{dotted(self._session.layout)}"), lambda: self._session.response
        )
        if answer is None:  # older 4.0 servers take it with the connection alone
            self._session.link.send(connect_with_version(self._session.layout))

    def _asked_rate(self) -> float | None:
        self._session.response = None
        return self._ask(request("FrameRate"), self._plausible_rate)

    def _plausible_rate(self) -> float | None:
        rate_hz = None if self._session.response is None else answered_number(self._session.response)
        return rate_hz if rate_hz is not None and 0.0 < rate_hz < _MOST_HZ else None

    def _ask(self, question: bytes, answer: Callable[[], Answer | None]) -> Answer | None:
        """Send a question, again if need be, until it is answered, refused, or there is no hope."""
        for _ in range(_TRIES):
            self._session.refused = False
            self._session.link.send(question)
            deadline_s = self._clock.now() + _PATIENCE_S
            while self._clock.now() < deadline_s and not self._session.refused:
                self._session.pump()
                reply = answer()
                if reply is not None:
                    return reply
            if self._session.refused:
                break
        return None
