"""The two other doors of the emulated box: web pages over HTTP, and 20-byte requests over TCP."""

import math
import struct
from dataclasses import dataclass, field
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from labrun.devices import FloatArray
from labrun.devices.emulated_ports import TcpEndpoint
from labrun.devices.emulation import EmulatorContext, EmulatorLog, Faults

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


class WebDoor:
    """Serves ``/netftapi2.xml``, and takes settings by ``/comm.cgi?name=value``; unknown names are ignored."""

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
            if not data or len(asked) > _LONGEST_REQUEST:
                self._endpoint.drop(client)
            elif b"\r\n\r\n" in asked:
                self._endpoint.send(client, self.answer(asked.partition(b"\r\n")[0]))
            else:
                self._asked[client] = asked
        return self._endpoint.flush(self._context.clock.now())

    def close(self) -> None:
        """Close it."""
        self._asked.clear()
        self._endpoint.close()

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


class TcpDoor:
    """Answers READFT (0) and READCALINFO (1)."""

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
            if not data:
                continue
            while len(asked) >= _TCP_REQUEST:
                request, asked = asked[:_TCP_REQUEST], asked[_TCP_REQUEST:]
                answer = self.answer(request)
                if answer:
                    self._endpoint.send(client, answer)
            self._asked[client] = asked
        return self._endpoint.flush(self._context.clock.now())

    def close(self) -> None:
        """Close it."""
        self._asked.clear()
        self._endpoint.close()

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
