"""A session with the server: who it is, in which layout it streams, and what keeps it streaming."""

import contextlib
from collections import deque
from dataclasses import dataclass

from labrun.devices import Clock, DeviceError
from labrun_plugins.optitrack.frame import Frame, decode_frame
from labrun_plugins.optitrack.link import Heard, Link, host_address, local_address
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
)
from labrun_plugins.optitrack.model import BodyModel, decode_model
from labrun_plugins.optitrack.settings import OptiTrackSettings

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

    Parameters
    ----------
    device
        Its name in the experiment file.
    settings
        Its table of the experiment file.
    clock
        The run's clock.

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

        Raises
        ------
        DeviceError
            The server is no longer the one that was connected to.
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
        """Whether it is open who streams, or which bodies the numbers in the frames stand for."""
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
                hint="Motive was restarted or its streaming pane changed; labrun resume connects anew",
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
