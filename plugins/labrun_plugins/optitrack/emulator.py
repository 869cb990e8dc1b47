"""Motive as the network sees it: commands, unicast and multicast frames, and its bad days."""

import math
import socket
import struct
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices.emulated_ports import Address, UdpEndpoint
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.optitrack import emulator_wire as wire
from labrun_plugins.optitrack.emulator_content import EmulatedCapture
from labrun_plugins.simulated.optitrack import SimulatedOptiTrackSettings

_LOOPBACK = "127.0.0.1"
_GROUP = "239.255.42.99"
_APP = (3, 1, 0, 0)
_CLOCK_HZ = 10_000_000
_DRIFT = -1e-5
_LATENCY_S = 0.0055
_JITTER_S = 0.0005
_FORGET_S = 5.0
_WRAP_AT = 2**31 - 5
_LAYOUTS: tuple[wire.Version, ...] = ((3, 0), (3, 1), (4, 0), (4, 1), (4, 2))
_RECORDING, _MODELS_CHANGED, _EDIT_MODE, _BITSTREAM_CHANGED = 1, 2, 4, 8
_MOST_BEHIND = 100
"""Frames made up for at once after the process was held up."""
_READY_S, _SPARE_S = 0.004, 0.0008
"""How long after its exposure a frame is made ready, and how long before it leaves it must be so at the latest."""
_MAKING_S = 0.0006
"""Looking at the bench takes about that long: not while another frame is to leave."""


class OptiTrackEmulator:
    """A Motive on loopback.

    Frames are exposed at the rate of the file, and sent 5.5 ms later; they are made ready meanwhile, so that nothing is
    left to do when they are due. Clients are forgotten 5 s after their last sign of life (chosen).

    Faults, besides the wire's own: natnet ("3.0", "3.1", "4.0", "4.1", "4.2": what it is) and multicast, from the
    beginning; unstamped (4.0 without precision stamps), layout (frames in this one, whatever was
    asked for), extra-nul (a byte more than the header counts), short-section (this many frames cut, header and all),
    tracking-lost, hidden-marker and missing-body (of all bodies, or of the one that is named), model-changed (once:
    other numbers), edit-mode and bitstream-changed (bits 2 and 3 of the params), restart (once: numbers begin again),
    reboot (once: numbers and clock begin again; the value is the new clock's rate), wrap (once: numbers are about to
    wrap), rate (what it says its rate is), forget (clients are forgotten after this many s), no-frames.
    """

    def __init__(self, name: str, settings: SimulatedOptiTrackSettings, context: EmulatorContext) -> None:
        self._settings = settings
        self._context = context
        self._faults = context.faults
        self._log = context.log
        self._endpoint = UdpEndpoint(context, _LOOPBACK)
        self._capture = EmulatedCapture(name, settings, context)
        self._natnet = _version(context.faults.value("natnet") or "4.1")
        self._multicast = context.faults.active("multicast") or settings.transmission == "multicast"
        self._group = settings.group or _GROUP
        self._data_port = 0
        self._clients: dict[Address, tuple[float, wire.Version]] = {}
        self._clock_hz = _CLOCK_HZ
        self._uptime_s = float(context.rng.uniform(10.0, 1000.0))
        self._number = 0
        self._exposed: deque[tuple[float, float]] = deque()  # when, and when it leaves: frames yet to be made
        self._next_s = 0.0
        self._leaves_s = 0.0
        self._made: deque[tuple[float, list[tuple[bytes, Address]]]] = deque()
        self._changed = False

    def open(self) -> Mapping[str, Any]:
        """Open the command socket; return where it is."""
        self._capture.open()
        port = self._endpoint.open()
        assert self._endpoint.socket is not None  # noqa: S101  it was just opened
        self._endpoint.socket.setsockopt(
            socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(_LOOPBACK)
        )
        self._data_port = self._free_port()
        self._next_s = self._leaves_s = self._context.clock.now()
        return {
            "host": _LOOPBACK, "interface": _LOOPBACK, "command_port": port, "data_port": self._data_port,
            "group": self._group,
        }  # fmt: skip

    def files(self) -> Sequence[int]:
        """Return the command socket."""
        return self._endpoint.fds

    def step(self, now_s: float) -> float:
        """Send the frames that are due; answer what arrived; make frames that were exposed meanwhile."""
        self._send_frames(now_s)
        self._endpoint.flush(self._context.clock.now())
        for datagram, address in self._endpoint.receive():
            answer = wire.understand(datagram)
            if answer is not None:
                self._answer(*answer, address, now_s)
        self._forget(now_s)
        self._strike()
        make_s = self._make_frames(now_s)
        left_s = self._endpoint.flush(self._context.clock.now())
        return min(left_s, make_s, self._made[0][0] if self._made else math.inf)

    def close(self) -> None:
        """Close the socket."""
        self._endpoint.close()

    def _answer(self, number: int, payload: bytes, address: Address, now_s: float) -> None:
        known = self._clients.get(address)
        if known is not None:
            self._clients[address] = (now_s, known[1])
        if number == wire.CONNECT:
            form, wanted = wire.connect_form(payload)
            layout = wanted if wanted in _LAYOUTS and self._natnet >= (4, 0) else self._natnet
            self._clients[address] = (now_s, known[1] if known is not None and wanted is None else layout)
            self._log.note("connect", form=form, layout=layout, address=address)
            self._endpoint.send(self._server_info(), address)
        elif number == wire.REQUEST:
            self._obey(payload.split(b"\0")[0].decode("utf-8", errors="replace"), address)
        elif number == wire.REQUEST_MODELDEF:
            layout = known[1] if known is not None else self._natnet
            self._log.note("model")
            self._endpoint.send(wire.model(self._capture.descriptions(), layout), address)
        elif number == wire.ECHOREQUEST and len(payload) >= 8:
            ticks = self._ticks(self._context.clock.now())
            self._endpoint.send(wire.echo_response(struct.unpack_from("<Q", payload)[0], ticks), address)
        elif number == wire.KEEPALIVE:
            self._log.note("keep-alive")
        elif number == wire.DISCONNECT:
            self._clients.pop(address, None)
            self._log.note("disconnect", address=address)
        else:
            self._endpoint.send(wire.message(wire.UNRECOGNIZED_REQUEST), address)

    def _obey(self, command: str, address: Address) -> None:
        self._log.note("request", command=command)
        name, _, argument = command.partition(",")
        answer = wire.message(wire.UNRECOGNIZED_REQUEST)
        seen_s, layout = self._clients.get(address, (0.0, self._natnet))
        if name == "FrameRate":
            answer = wire.number_response(self._faults.number("rate") or self._settings.rate_hz)
        elif name == "UnitsToMillimeters":
            answer = wire.number_response(1000.0)
        elif name == "Bitstream" and self._natnet >= (4, 0):
            wanted = _version(argument) if argument else layout
            if wanted in _LAYOUTS and wanted <= self._natnet and not self._multicast:
                if address in self._clients:
                    self._clients[address] = (seen_s, wanted)
                answer = wire.text_response(f"{wanted[0]}.{wanted[1]}")
        self._endpoint.send(answer, address)

    def _forget(self, now_s: float) -> None:
        for address, (seen_s, _) in list(self._clients.items()):
            if now_s - seen_s > (self._faults.number("forget") or _FORGET_S):
                del self._clients[address]
                self._log.note("forgotten", address=address)
                self._endpoint.send(wire.message(wire.DISCONNECTBYTIMEOUT), address)

    def _strike(self) -> None:
        """Let happen what happens once."""
        if self._faults.take("model-changed"):
            self._faults.set("model-changed", None)
            self._capture.renumber()
            self._changed = True
        if self._faults.take("restart"):
            self._faults.set("restart", None)
            self._number = 0
        if self._faults.take("wrap"):
            self._faults.set("wrap", None)
            self._number = _WRAP_AT
        if self._faults.active("reboot"):
            self._clock_hz = int(self._faults.number("reboot"))
            self._faults.set("reboot", None)
            self._uptime_s = -self._context.clock.now()
            self._number = 0

    def _send_frames(self, now_s: float) -> None:
        while self._made and self._made[0][0] <= now_s:
            for datagram, address in self._made.popleft()[1]:
                self._endpoint.send(datagram, address)

    def _make_frames(self, now_s: float) -> float:
        """Make frames that were exposed, several at a time, while none is to leave; return when to be called again."""
        while self._next_s <= now_s:
            self._expose()
        if not self._exposed:
            return self._next_s + _READY_S
        ready_s, leaves_s = self._exposed[0][0] + _READY_S, self._exposed[0][1]
        if now_s < ready_s:
            return ready_s
        if self._made and self._made[0][0] - now_s < _MAKING_S and leaves_s - now_s > _SPARE_S:
            return self._made[0][0]
        self._make()
        return self._exposed[0][0] + _READY_S if self._exposed else self._next_s + _READY_S

    def _make(self) -> None:
        exposed = [self._exposed.popleft() for _ in range(min(len(self._exposed), _MOST_BEHIND))]
        if not (self._clients or self._multicast):
            self._number += len(exposed)
            return
        rows = self._capture.measure(np.array([time_s for time_s, _ in exposed]))
        for (time_s, leaves_s), row in zip(exposed, rows, strict=True):
            self._number += 1
            number = (self._number + 2**31) % 2**32 - 2**31
            if self._faults.active("no-frames"):
                continue
            content = self._capture.content(
                number, row,
                timestamp=time_s + self._uptime_s,
                ticks=tuple(self._ticks(at_s) for at_s in (time_s, time_s + 0.004, leaves_s)),
                precision=(int(time_s), 7), params=self._params(), stamped=not self._faults.active("unstamped"),
            )  # fmt: skip
            self._made.append((leaves_s, self._datagrams(content)))

    def _datagrams(self, content: wire.Content) -> list[tuple[bytes, Address]]:
        """Return a frame as each client gets it."""
        stated = self._faults.value("layout")
        if self._multicast:
            targets = [((self._group, self._data_port), self._natnet)]
        else:
            targets = [(address, layout) for address, (_, layout) in self._clients.items()]
        made = []
        for address, layout in targets:
            datagram = wire.frame(content, _version(stated) if stated else layout)
            if self._faults.take("short-section"):
                datagram = wire.message(wire.FRAMEOFDATA, datagram[4 : len(datagram) // 2])
            if self._faults.active("extra-nul"):
                datagram += b"\0"
            made.append((datagram, address))
        return made

    def _expose(self) -> None:
        """Expose a frame, and choose when it leaves: frames do not overtake each other."""
        delay_s = _LATENCY_S + float(self._context.rng.exponential(_JITTER_S))
        self._leaves_s = max(self._leaves_s, self._next_s + delay_s)
        self._exposed.append((self._next_s, self._leaves_s))
        self._next_s += 1.0 / self._settings.rate_hz

    def _params(self) -> int:
        params = _RECORDING
        params |= _MODELS_CHANGED * self._changed
        params |= _EDIT_MODE * self._faults.active("edit-mode")
        params |= _BITSTREAM_CHANGED * self._faults.active("bitstream-changed")
        self._changed = False
        return params

    def _ticks(self, time_s: float) -> int:
        return round((time_s + self._uptime_s) * (1.0 + _DRIFT) * self._clock_hz) % 2**64

    def _server_info(self) -> bytes:
        natnet = (*self._natnet, 0, 0)
        return wire.server_info(_APP, natnet, self._clock_hz, self._data_port, self._multicast, self._group)

    @staticmethod
    def _free_port() -> int:
        """Return a port that nobody else on this computer uses for multicast."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((_LOOPBACK, 0))
            return int(probe.getsockname()[1])


def _version(text: str) -> wire.Version:
    major, _, minor = str(text).partition(".")
    return (int(major), int(minor)) if major.isdigit() and minor.isdigit() else (0, 0)
