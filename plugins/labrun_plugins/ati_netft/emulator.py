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
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices import DeviceContext, FloatArray
from labrun.devices.emulated_ports import Address, UdpEndpoint
from labrun.devices.emulation import NEVER, EmulatorContext
from labrun_plugins.ati_netft.emulated_doors import CPF, CPT, BoxState, TcpDoor, WebDoor
from labrun_plugins.ati_netft.settings import full_scale
from labrun_plugins.simulated.ati_netft import SimulatedAtiNetFt, SimulatedAtiNetFtSettings

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
