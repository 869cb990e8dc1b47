"""An FT300 as seen from the wire: registers over Modbus RTU, the stream, and the jam that ends it.

Written from the manuals' description of the line, independently of the driver: it shares no code with it but the names
of the settings, so that each checks the other.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices import DeviceContext
from labrun.devices.emulated_ports import PtyEndpoint
from labrun.devices.emulation import NEVER, EmulatorContext
from labrun_plugins.robotiq_ft300.emulated_modbus import ModbusSlave, Refusal, checksum
from labrun_plugins.simulated.robotiq_ft300 import SimulatedRobotiqFt300, SimulatedRobotiqFt300Settings

_PERIOD_S = 0.01
_FIRST_FRAME_S = 0.03
"""From the request on: its acknowledgement comes before."""
_TURNAROUND_S = 0.001
_DEAF_S = 0.08
"""After a jam, before it listens again."""
_JAM_BYTES = 45
"""This many FF on end make it leave the stream."""
_QUIET_S = 0.2
"""A request that is still incomplete after this long is forgotten; an RTU line would take 1.8 ms."""
_COUNTS_PER_UNIT = (100, 100, 100, 1000, 1000, 1000)
_STEADY_REGISTERS = {
    500: 0x4654, 501: 0x5301, 502: 0x0203,                  # FTS 1.2.3
    510: 0x4654, 511: 0x5300, 512: 1234, 513: 0, 514: 2021,
}  # fmt: skip
_ONE_G = 1000
_MOST = 32_767


class RobotiqFt300Emulator:
    """What it measures comes from the stand-in of a dry run, sampled every 10 ms.

    A request is answered after the time it and its answer take on the wire. What no source tells is chosen: it listens
    again 80 ms after a jam, and takes 45 FF on end for one.

    Faults, besides those of the wire: ``streaming`` (count: streams without having been asked to, as after a run that
    was killed), ``restart`` (count: loses its supply for a moment, and with it the stream), ``saturate`` (all axes at
    the end of the range), ``error`` (count: refuses with exception 02), ``wrong-id`` (says it is something else),
    ``wrong-slave`` (listens to another address), ``stubborn`` (count: jams it ignores), ``alias`` (Fx = 200.00 N,
    whose bytes are those of the header), ``rate`` (frames per second), ``garbage`` (count: foreign bytes before a
    frame).
    """

    def __init__(self, name: str, settings: SimulatedRobotiqFt300Settings, context: EmulatorContext) -> None:
        self._context = context
        self._clock = context.clock
        self._faults = context.faults
        self._log = context.log
        # Paced here, by when a sensor would have sent: if this process is held up, what is late comes at once then, as
        # from the buffer of an adapter, and does not go on being late at the pace of the line.
        self._line = PtyEndpoint(context, name)
        self._byte_s = 10.0 / settings.baud
        device = DeviceContext(clock=context.clock, rng=context.rng, scene=context.scene)
        self._sensor = SimulatedRobotiqFt300(name, settings, device)
        self._slave_id = settings.slave_id
        self._slave = ModbusSlave(settings.slave_id, self._value, self._set)
        self._under_way: deque[tuple[float, bytes]] = deque()
        self._heard_s = -NEVER
        self._deaf_until_s = -NEVER
        self._frame_due_s: float | None = None
        self._jam = 0

    def open(self) -> Mapping[str, Any]:
        """Open its port."""
        self._sensor.open()
        self._counts(self._clock.now())  # compiles what it takes, so that the first frames are not late
        path = self._line.open()
        return {"port": path}

    def files(self) -> Sequence[int]:
        """Return what to wait on."""
        return self._line.fds

    def step(self, now_s: float) -> float:
        """Hear requests and jams; send answers and frames that are due."""
        data = self._line.receive()
        if self._faults.take("streaming"):
            self._stream()
        if self._faults.take("restart"):
            self._log.note("restart")
            self._frame_due_s = None
        if data:
            self._hear(data, now_s)
        if self._frame_due_s is not None:
            self._send_frames(now_s)
        while self._under_way and self._under_way[0][0] <= now_s:
            self._line.send(self._under_way.popleft()[1])
        due_s = self._line.flush(now_s)
        if self._under_way:
            due_s = min(due_s, self._under_way[0][0])
        if self._frame_due_s is not None:
            due_s = min(due_s, self._frame_due_s)
        return due_s

    def close(self) -> None:
        """Close its port."""
        self._line.close()
        self._sensor.close()

    def _hear(self, data: bytes, now_s: float) -> None:
        if self._frame_due_s is not None:
            self._hear_while_streaming(data, now_s)
            return
        if now_s < self._deaf_until_s:
            return
        if now_s - self._heard_s > _QUIET_S:
            self._slave.forget()
        self._heard_s = now_s
        self._slave.slave_id = (
            self._slave_id % 247 + 1 if self._faults.active("wrong-slave") else self._slave_id
        )
        for taken, answer in self._slave.hear(data):
            self._log.note("request", frame=taken, answer=answer)
            self._put_under_way(answer, now_s + len(taken) * self._byte_s + _TURNAROUND_S)

    def _hear_while_streaming(self, data: bytes, now_s: float) -> None:
        for byte in data:
            self._jam = self._jam + 1 if byte == 0xFF else 0
            if self._jam < _JAM_BYTES:
                continue
            self._jam = 0
            if self._faults.take("stubborn"):
                self._log.note("jam ignored")
                return
            self._log.note("stop", how="jam")
            self._frame_due_s = None
            self._deaf_until_s = now_s + _DEAF_S
            self._slave.forget()
            return

    def _stream(self) -> None:
        self._log.note("stream")
        self._frame_due_s = self._clock.now() + _FIRST_FRAME_S
        self._jam = 0

    def _send_frames(self, now_s: float) -> None:
        period_s = 1.0 / self._faults.number("rate") if self._faults.active("rate") else _PERIOD_S
        while self._frame_due_s is not None and self._frame_due_s <= now_s:
            if self._faults.take("garbage"):
                noise = self._context.rng.integers(0, 256, 7, dtype=np.uint8)
                self._put_under_way(noise.tobytes(), self._frame_due_s)
            self._put_under_way(stream_frame(self._counts(self._frame_due_s)), self._frame_due_s)
            self._frame_due_s += period_s

    def _put_under_way(self, message: bytes, begin_s: float) -> None:
        """Send a message from a time on; it arrives with its last byte, and not before those sent earlier."""
        if self._under_way:
            begin_s = max(begin_s, self._under_way[-1][0])
        self._under_way.append((begin_s + len(message) * self._byte_s, message))

    def _counts(self, time_s: float) -> list[int]:
        values, _ = self._sensor.measure(np.array([time_s]))
        if self._faults.active("saturate"):
            return [30_000] * 6
        scaled = np.nan_to_num(values[0] * _COUNTS_PER_UNIT, nan=_MOST)
        counts = [round(float(count)) for count in np.clip(scaled, -_MOST, _MOST)]
        if self._faults.active("alias"):
            counts[0] = 20_000
        return counts

    def _value(self, register: int) -> int:
        """Return what stands in a register; Refusal if there is none."""
        if self._faults.take("error"):
            raise Refusal(2)
        if 180 <= register <= 185:
            return self._counts(self._clock.now())[register - 180] & 0xFFFF
        if 190 <= register <= 192:
            return _ONE_G if register == 192 else 0
        if register == 410:
            return 0x0200 if self._frame_due_s is not None else 0
        if register == 500 and self._faults.active("wrong-id"):
            return 0x4752  # G R: a gripper
        if register not in _STEADY_REGISTERS:
            raise Refusal(2)
        return _STEADY_REGISTERS[register]

    def _set(self, register: int, value: int) -> None:
        """Write a register; Refusal if it cannot be written, or not with this."""
        if self._faults.take("error") or register != 410:
            raise Refusal(2)
        if value not in (0, 0x0200):
            raise Refusal(3)
        if value:
            self._stream()


def stream_frame(counts: Sequence[int]) -> bytes:
    """Return a frame of the stream: header, six counts, low byte first, checksum."""
    frame = bytearray((0x20, 0x4E))
    for count in counts:
        frame += bytes((count & 0xFF, (count >> 8) & 0xFF))
    return bytes(frame) + checksum(frame)
