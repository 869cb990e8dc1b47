"""An FT300 as seen from the wire: registers over Modbus RTU, the stream, and the jam that ends it.

Written from the manuals' description of the line, independently of the driver: it shares no code with it but the names
of the settings, so that each checks the other.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices import DeviceContext
from labrun.devices.emulated_ports import PtyEndpoint
from labrun.devices.emulation import NEVER, EmulatorContext
from labrun_plugins.simulated.robotiq_ft300 import SimulatedRobotiqFt300, SimulatedRobotiqFt300Settings

_READ, _WRITE_ONE, _WRITE_MANY = 0x03, 0x06, 0x10
_MOST_READ = 125
_LONGEST = 256


class Refusal(Exception):  # noqa: N818  not an error: one of the answers of the protocol
    """An exception code instead of an answer: 01 function, 02 register, 03 value."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code:02d}")
        self.code = code


def checksum(data: bytes | bytearray) -> bytes:
    """Return the two bytes that end a frame: remainder of the division by x^16 + x^15 + x^2 + 1, bits reversed."""
    remainder = 0xFFFF
    for byte in data:
        remainder ^= byte
        for _ in range(8):
            carry = remainder & 1
            remainder >>= 1
            if carry:
                remainder ^= 0xA001
    return bytes((remainder & 0xFF, remainder >> 8))


class ModbusSlave:
    """Answers requests for one address; stays silent to all else, as a real one does.

    Parameters
    ----------
    value
        Reads one register, 0 ... 65535; raises Refusal.
    set_value
        Writes one register; raises Refusal.

    """

    def __init__(
        self, slave_id: int, value: Callable[[int], int], set_value: Callable[[int, int], None]
    ) -> None:
        self.slave_id = slave_id
        self._value = value
        self._set_value = set_value
        self._kept = bytearray()

    def forget(self) -> None:
        """Drop what has come of an unfinished request: the line was quiet for a while."""
        self._kept.clear()

    def hear(self, data: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Take bytes; yield each request to this slave that they complete, and its answer."""
        self._kept += data
        del self._kept[: -2 * _LONGEST]
        while len(self._kept) >= 8:
            size = self._size()
            if size is not None and len(self._kept) < size:
                return
            frame = bytes(self._kept[:size]) if size is not None else b""
            if not frame or checksum(frame[:-2]) != frame[-2:]:
                del self._kept[0]
                continue
            del self._kept[: len(frame)]
            if frame[0] == self.slave_id:
                yield frame, self._answer(frame)

    def _size(self) -> int | None:
        """Return how long the request at the head of what was kept is; None if it is none."""
        function = self._kept[1]
        if function == _WRITE_MANY:
            count = self._kept[6]
            return 9 + count if count and count % 2 == 0 and 9 + count <= _LONGEST else None
        return 8 if 1 <= function <= _WRITE_ONE else None

    def _answer(self, frame: bytes) -> bytes:
        function = frame[1]
        address = (frame[2] << 8) | frame[3]
        argument = (frame[4] << 8) | frame[5]
        try:
            if function == _READ:
                body = self._read(address, argument)
            elif function == _WRITE_ONE:
                self._set_value(address, argument)
                body = frame[2:6]
            elif function == _WRITE_MANY:
                body = self._write(address, argument, frame[7:-2])
            else:
                raise Refusal(1)
        except Refusal as refusal:
            function |= 0x80
            body = bytes((refusal.code,))
        answer = bytes((frame[0], function)) + body
        return answer + checksum(answer)

    def _read(self, address: int, count: int) -> bytes:
        if not 1 <= count <= _MOST_READ:
            raise Refusal(3)
        values = [self._value(register) for register in range(address, address + count)]
        return bytes((2 * count,)) + b"".join(bytes((v >> 8, v & 0xFF)) for v in values)

    def _write(self, address: int, count: int, data: bytes) -> bytes:
        if len(data) != 2 * count:
            raise Refusal(3)
        for number in range(count):
            self._set_value(address + number, (data[2 * number] << 8) | data[2 * number + 1])
        return bytes((address >> 8, address & 0xFF, count >> 8, count & 0xFF))


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
