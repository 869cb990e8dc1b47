"""The Net F/T box as it looks from the network: RDT over UDP, its web pages, and its TCP port.

What it measures comes from the sensor's stand-in and its scene. Written after the ATI manuals 9620-05-NET FT and
9610-05-Ethernet Axia, chapter 10; it shares no code with the driver.

Faults of the wire come from its endpoints (silence, late, drop, duplicate, reorder, truncate ...). Faults of the box:

- ``saturate``: all axes at the end of their range, status 80020000.
- ``error``: the status, as a number (by default 90000000, analogue board).
- ``condition``: a monitor condition trips, status 80010000; latched until it is reset by command 0041.
- ``restart`` (count): the numbering of the running stream begins anew.
- ``wrap``: both counters stand just before their wrap when the next stream starts.
- ``reboot`` (count): the box is switched off and on: it streams no more, and counts its samples from zero.
- ``reset-counters`` (count): as `reboot`, but it goes on streaming.
- ``stale``: it repeats one measurement.
- ``ignore-settings``: a change of a setting is ignored, as a misspelt one is.
- ``unreachable``: nothing listens any more.
"""

import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from labrun.devices import DeviceContext, FloatArray
from labrun.devices.emulated_ports import Address, TcpEndpoint, UdpEndpoint
from labrun.devices.emulation import NEVER, EmulatorContext, EmulatorLog, Faults
from labrun_plugins.ati_netft.settings import full_scale
from labrun_plugins.simulated.ati_netft import SimulatedAtiNetFt, SimulatedAtiNetFtSettings

CPF = 1_000_000
"""Counts per N."""
CPT = 1_000_000
"""Counts per N m; the box gives them per N-mm, as most do."""
_CPT_PER_N_MM = CPT // 1000
_SCALE = (3, 3, 9, 61, 61, 61)
_LONGEST_REQUEST = 8192
_TCP_REQUEST = 20


@dataclass
class BoxState:
    """What the doors of the box share."""

    log: EmulatorLog
    faults: Faults
    rate_hz: int = 7000
    buffer_size: int = 40
    latched: bool = False
    last_status: int = 0
    last_values: FloatArray = field(default_factory=lambda: np.zeros(6))


class Door(ABC):
    """One of the box's ports: answers what clients ask, whole request by whole request."""

    def __init__(self, context: EmulatorContext, host: str, state: BoxState) -> None:
        self._context = context
        self._host = host
        self._state = state
        self._endpoint = TcpEndpoint(context, host)
        self._asked: dict[int, bytes] = {}

    @property
    def fds(self) -> list[int]:
        """What to wait on."""
        return self._endpoint.fds

    def open(self, port: int) -> int:
        """Open it at this port, or a free one for 0; return the port."""
        self._endpoint = TcpEndpoint(self._context, self._host, port)
        return self._endpoint.open()

    def step(self) -> float:
        """Answer what was asked; return when the next answer is due."""
        self._endpoint.accept()
        for client, data in self._endpoint.receive():
            asked = self._asked.pop(client, b"") + data
            rest = self._answered(client, asked) if data else b""
            if rest:
                self._asked[client] = rest
        return self._endpoint.flush(self._context.clock.now())

    def close(self) -> None:
        """Close it."""
        self._asked.clear()
        self._endpoint.close()

    @abstractmethod
    def _answered(self, client: int, asked: bytes) -> bytes:
        """Answer all requests that are whole; return what is left."""


class WebDoor(Door):
    """Serves ``/netftapi2.xml``, and takes settings by ``/comm.cgi?name=value``; unknown names are ignored."""

    def _answered(self, client: int, asked: bytes) -> bytes:
        if len(asked) > _LONGEST_REQUEST:
            self._endpoint.drop(client)
        elif b"\r\n\r\n" in asked:
            self._endpoint.send(client, self.answer(asked.partition(b"\r\n")[0]))
        else:
            return asked
        return b""

    def answer(self, line: bytes) -> bytes:
        """Return the answer to a request that begins with this line."""
        parts = line.decode("latin-1").split(" ")
        if len(parts) != 3 or parts[0] != "GET":
            return _page("400 Bad Request", "")
        try:
            url = urlsplit(parts[1])
        except ValueError:
            return _page("400 Bad Request", "")
        self._state.log.note("http", path=parts[1])
        if url.path == "/netftapi2.xml":
            return _page("200 OK", self._xml(), "text/xml")
        if url.path in ("/comm.cgi", "/setting.cgi"):
            for name, value in parse_qsl(url.query):
                self._set(name, value)
            return _page("200 OK", "<html><body>ok</body></html>")
        return _page("404 Not Found", "")

    def _set(self, name: str, value: str) -> None:
        if self._state.faults.active("ignore-settings") or not (value.isascii() and value.isdigit()):
            return
        number = int(value[:9])
        if name == "comrdtrate" and 1 <= number <= 7000:
            self._state.rate_hz = number
            self._state.log.note("command", comrdtrate=number)
        elif name == "comrdtbsiz" and 1 <= number <= 40:
            self._state.buffer_size = number
            self._state.log.note("command", comrdtbsiz=number)

    def _xml(self) -> str:
        state = self._state
        values = {
            "prodname": "Net F/T (emulated)",
            "setserial": "FT00000",
            "runstat": f"0x{state.last_status:08X}",
            "cfgcpf": CPF,
            "cfgcpt": _CPT_PER_N_MM,
            "scfgfu": "N",
            "scfgtu": "N-mm",
            "comrdtrate": state.rate_hz,
            "comrdtbsiz": state.buffer_size,
        }
        body = "".join(f"<{name}>{value}</{name}>" for name, value in values.items())
        return f'<?xml version="1.0" encoding="ISO-8859-1"?><netft>{body}</netft>'


class TcpDoor(Door):
    """Answers READFT (0) and READCALINFO (1)."""

    def _answered(self, client: int, asked: bytes) -> bytes:
        while len(asked) >= _TCP_REQUEST:
            request, asked = asked[:_TCP_REQUEST], asked[_TCP_REQUEST:]
            if answer := self.answer(request):
                self._endpoint.send(client, answer)
        return asked

    def answer(self, request: bytes) -> bytes:
        """Return the answer to a request of 20 bytes; nothing to one that is not known."""
        if request[0] == 0x00:
            raw = [
                math.floor(value * per_unit / scale + 0.5)
                for value, per_unit, scale in zip(
                    self._state.last_values, (CPF,) * 3 + (CPT,) * 3, _SCALE, strict=True
                )
            ]
            raw = [max(-32768, min(32767, value)) for value in raw]
            return struct.pack(">HH6h", 0x1234, self._state.last_status >> 16, *raw)
        if request[0] == 0x01:
            return struct.pack(">HBBII6H", 0x1234, 2, 4, CPF, _CPT_PER_N_MM, *_SCALE)
        return b""


def _page(status: str, body: str, kind: str = "text/html") -> bytes:
    head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    return (head + body).encode("latin-1")


_HOST = "127.0.0.1"
_INTERNAL_HZ = 7000.0
_CLOCK_DRIFT = 2e-5
_BATCH_S = 0.003
_MOST_AT_ONCE = 1400
_PATIENCE_MS = 500.0
"""A busy computer that plays the box may fall silent for longer than the box ever does."""
_RECORD = struct.Struct(">IIIiiiiii")
_WRAP = 1 << 32


class AtiNetFtEmulator:
    """One box, with one sensor."""

    def __init__(self, name: str, settings: SimulatedAtiNetFtSettings, context: EmulatorContext) -> None:
        self._settings = settings
        self._clock = context.clock
        self._faults = context.faults
        self._log = context.log
        self._sensor = SimulatedAtiNetFt(
            name, settings, DeviceContext(context.clock, context.rng, context.scene)
        )
        if context.scene is not None:
            self._sensor.open()
        self._context = context
        self._end = np.array(full_scale(settings.calibration))
        self._state = BoxState(self._log, self._faults)
        self._rdt = UdpEndpoint(context, _HOST)
        self._web = WebDoor(context, _HOST, self._state)
        self._tcp = TcpDoor(context, _HOST, self._state)
        self._ports: tuple[int, int, int] = (0, 0, 0)
        self._reachable = False
        self._client: Address | None = None
        self._left: float = 0
        self._together = 1
        self._sequence = 1
        self._ft_base = 0
        self._ft_origin_s = 0.0
        self._next_ft = 0
        self._last_sent_ft = 0
        self._gathered = b""
        self._bias = np.zeros(6)

    def open(self) -> Mapping[str, Any]:
        """Open its ports; return how the driver reaches them."""
        self._ft_origin_s = self._clock.now()
        self._sensor.measure(np.array([self._ft_origin_s]))  # compiled before anybody waits for an answer
        self._open_doors()
        rdt, http, tcp = self._ports
        reached_by: dict[str, Any] = {"host": _HOST, "rdt_port": rdt, "http_port": http, "tcp_port": tcp}
        if "silence_ms" not in self._settings.model_fields_set:
            reached_by["silence_ms"] = _PATIENCE_MS
        return {**reached_by, "interface": None}

    def files(self) -> Sequence[int]:
        """Return the sockets to wait on."""
        return [*self._rdt.fds, *self._web.fds, *self._tcp.fds]

    def step(self, now_s: float) -> float:
        """Answer what was asked, and send what is due."""
        if self._faults.active("unreachable"):
            self._close_doors()
            return NEVER
        if not self._reachable:
            self._open_doors()
        for message, address in self._rdt.receive():
            self._obey(message, address)
        due_s = min(self._web.step(), self._tcp.step())
        self._suffer(now_s)
        if self._client is not None:
            self._stream(now_s)
            due_s = min(due_s, now_s + max(_BATCH_S, 0.5 * self._step_size() / _INTERNAL_HZ))
        return min(due_s, self._rdt.flush(self._clock.now()))

    def close(self) -> None:
        """Close all ports."""
        self._close_doors()

    def _obey(self, message: bytes, address: Address) -> None:
        if len(message) != 8 or message[:2] != b"\x12\x34":
            self._log.note("rejected", message=message)
            return
        command, count = struct.unpack(">HI", message[2:])
        if command == 0x0000:
            self._log.note("stop", how="request", address=address)
            if address == self._client:
                self._end_stream()
        elif command in (0x0002, 0x0003):
            self._begin_stream(address, count, self._state.buffer_size if command == 0x0003 else 1)
        elif command == 0x0041:
            self._log.note("latch-reset")
            self._state.latched = False
        elif command == 0x0042:
            self._log.note("bias")
            self._bias = self._sensor.measure(np.array([self._clock.now()]))[0][0]
        else:
            self._log.note("rejected", message=message)

    def _begin_stream(self, address: Address, count: int, together: int) -> None:
        if self._client is not None and self._client != address:
            self._log.note("stolen", address=self._client, by=address)
        self._log.note("start", address=address, count=count, together=together)
        self._client, self._left, self._together = address, count or math.inf, together
        self._gathered = b""
        self._sequence = 1
        if self._faults.active("wrap"):
            self._sequence = _WRAP - 50
            self._ft_base = (_WRAP - 50 * self._step_size() - self._elapsed(self._clock.now())) % _WRAP
        self._next_ft = self._elapsed(self._clock.now()) + 1
        if count:  # a sample that is asked for is the one at hand
            self._next_ft = max(self._next_ft - count * self._step_size(), 0)

    def _end_stream(self) -> None:
        self._client, self._gathered = None, b""

    def _suffer(self, now_s: float) -> None:
        if self._faults.active("condition"):
            self._state.latched = True
        if self._faults.active("restart") and self._client is not None and self._faults.take("restart"):
            self._log.note("restarted", sequence=self._sequence)
            self._sequence = 1
        for fault in ("reboot", "reset-counters"):
            if self._faults.active(fault) and self._faults.take(fault):
                self._log.note("rebooted")
                self._ft_origin_s, self._ft_base, self._next_ft, self._sequence = now_s, 0, 1, 1
                if fault == "reboot":
                    self._end_stream()

    def _stream(self, now_s: float) -> None:
        step = self._step_size()
        due = (self._elapsed(now_s) - self._next_ft) // step + 1
        count = int(min(due, _MOST_AT_ONCE, self._left))
        if count <= 0 or self._client is None:
            return
        counters = self._next_ft + step * np.arange(count)
        self._next_ft = int(counters[-1]) + step
        taken_s = self._ft_origin_s + counters / (_INTERNAL_HZ * (1.0 + _CLOCK_DRIFT))
        values, status = self._measured(taken_s)
        counts = np.clip(np.rint(values * (CPF, CPF, CPF, CPT, CPT, CPT)), -(2**31), 2**31 - 1).astype(int)
        if self._faults.active("stale"):
            counters = np.full(count, self._last_sent_ft)
        self._last_sent_ft = int(counters[-1])
        for ft, word, row in zip(counters.tolist(), status.tolist(), counts.tolist(), strict=True):
            number = (self._ft_base + ft) % _WRAP
            self._gathered += _RECORD.pack(self._sequence, number, word, *row)
            self._sequence = (self._sequence + 1) % _WRAP
            if len(self._gathered) >= self._together * _RECORD.size:
                self._rdt.send(self._gathered, self._client)
                self._gathered = b""
        self._left -= count
        if self._left <= 0:
            if self._gathered:
                self._rdt.send(self._gathered, self._client)
            self._end_stream()

    def _measured(self, time_s: FloatArray) -> tuple[FloatArray, np.ndarray[Any, np.dtype[np.int64]]]:
        values = self._sensor.measure(time_s)[0]
        if self._faults.active("saturate"):
            values = np.broadcast_to(self._end, values.shape)
        status = np.where((np.abs(values) >= self._end).any(axis=1), 0x8002_0000, 0)
        if self._state.latched:
            status |= 0x8001_0000
        if self._faults.active("error"):
            value = self._faults.value("error")
            status |= 0x9000_0000 if value is True else int(value)
        self._state.last_status, self._state.last_values = int(status[-1]), values[-1] - self._bias
        return values - self._bias, status

    def _step_size(self) -> int:
        """Return by how much the sample counter rises from record to record."""
        return max(1, round(_INTERNAL_HZ / self._state.rate_hz))

    def _elapsed(self, now_s: float) -> int:
        return int((now_s - self._ft_origin_s) * _INTERNAL_HZ * (1.0 + _CLOCK_DRIFT))

    def _open_doors(self) -> None:
        rdt, http, tcp = self._ports
        self._rdt = UdpEndpoint(self._context, _HOST, rdt)
        self._ports = (self._rdt.open(), self._web.open(http), self._tcp.open(tcp))
        self._reachable = True

    def _close_doors(self) -> None:
        if self._reachable:
            self._reachable = False
            self._end_stream()
            self._rdt.close()
            self._web.close()
            self._tcp.close()
