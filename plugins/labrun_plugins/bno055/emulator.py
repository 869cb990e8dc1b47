"""A BNO055 as seen from its serial line.

Written from the data sheet's description of the line, independently of the driver: it shares no code with it but the
names of the settings, so that each checks the other.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labrun.devices import DeviceContext, FloatArray
from labrun.devices.emulated_ports import PtyEndpoint
from labrun.devices.emulation import NEVER, EmulatorContext
from labrun_plugins.simulated.bno055 import SimulatedBno055, SimulatedBno055Settings

_BOOT_S = 0.65
_TO_CONFIG_S = 0.019
_FROM_CONFIG_S = 0.007
_GYRO_READY_S = 2.0
_G = 9.80665
_LAST_REGISTER = 0x6A
_FUSION = (0x08, 0x09, 0x0A, 0x0B, 0x0C)
_WITH_MAGNETOMETER = (0x09, 0x0A, 0x0B, 0x0C)

READ_FAIL, WRITE_FAIL, NO_REGISTER, READ_ONLY, OVERRUN, TOO_LONG, TOO_SHORT = 2, 3, 4, 5, 7, 8, 9
_WRITTEN = 1


@dataclass(frozen=True, slots=True)
class Motion:
    """What the chip feels at one fusion step, in SI units, and the angles it makes of it."""

    quaternion: Sequence[float]
    heading_roll_pitch_rad: Sequence[float]
    gyro_rad_s: Sequence[float]


class Status(Exception):  # noqa: N818  one of the chip's answers
    """An answer EE with a status."""

    def __init__(self, code: int) -> None:
        super().__init__(f"status {code:02X}")
        self.code = code


class EmulatedChip:
    """Registers 00-6A of page 0 as the data sheet has them; page 1 is there, and empty.

    Configuration can be written only in mode CONFIG; a change of mode takes 19 ms to CONFIG and 7 ms from it, within
    which the chip is busy. Data registers are 0 in CONFIG. Units follow the unit select register, whose value after a
    reset is 80 (Android orientation).

    Parameters
    ----------
    feel
        Returns what it feels at the fusion step of a time.

    Attributes
    ----------
    chip_id
        What register 00 says.
    system_error
        Shows a system error of this number, if not 0.
    """

    def __init__(self, feel: Callable[[float], Motion]) -> None:
        self._feel = feel
        self.chip_id = 0xA0
        self.system_error = 0
        self._config = bytearray()
        self._page = 0
        self._mode = 0
        self._busy_until_s = -math.inf
        self._awake_s = -math.inf
        self._fusing_since_s = math.inf
        self._clear()

    def boot(self, now_s: float) -> None:
        """Begin anew, as after a reset: silent for 650 ms, then with the settings of delivery."""
        self._clear()
        self._awake_s = now_s + _BOOT_S

    def awake(self, now_s: float) -> bool:
        """Tell whether it has booted."""
        return now_s >= self._awake_s

    def read(self, register: int, count: int, now_s: float) -> bytes:
        """Return registers; Status in place of them."""
        if not 1 <= count <= 128:
            raise Status(TOO_SHORT if count < 1 else TOO_LONG)
        if register + count - 1 > (_LAST_REGISTER if self._page == 0 else 0x7F):
            raise Status(NO_REGISTER)
        if now_s < self._busy_until_s:
            raise Status(OVERRUN)
        page = self._page_0(now_s) if self._page == 0 else self._page_1()
        return bytes(page[register : register + count])

    def write(self, register: int, data: bytes, now_s: float) -> int:
        """Write registers, and return the status that tells so; Status if it cannot be done."""
        if not data:
            raise Status(TOO_SHORT)
        if len(data) > 128:
            raise Status(TOO_LONG)
        if register + len(data) - 1 > _LAST_REGISTER:
            raise Status(NO_REGISTER)
        if now_s < self._busy_until_s:
            raise Status(OVERRUN)
        for number, value in enumerate(data):
            self._write_one(register + number, value, now_s)
        return _WRITTEN

    def _write_one(self, register: int, value: int, now_s: float) -> None:
        if register == 0x07:
            self._page = value & 1
        elif self._page != 0:
            raise Status(READ_ONLY)
        elif register == 0x3D:
            self._change_mode(value & 0x0F, now_s)
        elif register == 0x3F:
            if value & 0x20:
                self.boot(now_s)
        elif register < 0x3B:
            raise Status(READ_ONLY)
        elif self._mode != 0:
            raise Status(WRITE_FAIL)
        else:
            self._config[register] = value

    def _change_mode(self, mode: int, now_s: float) -> None:
        if mode == self._mode:
            return
        self._busy_until_s = now_s + (_TO_CONFIG_S if mode == 0 else _FROM_CONFIG_S)
        self._mode = mode
        self._fusing_since_s = self._busy_until_s if mode in _FUSION else math.inf

    def _clear(self) -> None:
        self._config = bytearray(128)
        self._config[0x3B] = 0x80
        self._config[0x67:0x6B] = bytes((0xE8, 0x03, 0xE0, 0x01))  # radii of accelerometer and magnetometer
        self._page = 0
        self._mode = 0
        self._busy_until_s = -math.inf
        self._fusing_since_s = math.inf

    def _page_1(self) -> bytearray:
        page = bytearray(128)
        page[0x07] = 1
        return page

    def _page_0(self, now_s: float) -> bytearray:
        page = bytearray(self._config)
        page[0x00:0x08] = bytes((self.chip_id, 0xFB, 0x32, 0x0F, 0x11, 0x03, 0x15, 0x00))
        page[0x3D] = self._mode
        page[0x34] = 77 if self._config[0x3B] & 0x10 else 25
        if self._mode != 0:
            self._fill_motion(page, now_s)
            page[0x35] = self._calibration(now_s)
        page[0x36] = 0x0F
        page[0x39], page[0x3A] = (1, self.system_error) if self.system_error else (5 if self._mode else 0, 0)
        return page

    def _calibration(self, now_s: float) -> int:
        gyro = 3 if now_s - self._fusing_since_s >= _GYRO_READY_S else 0
        magnetometer = 3 if self._mode in _WITH_MAGNETOMETER else 0
        return gyro << 6 | gyro << 4 | 3 << 2 | magnetometer

    def _fill_motion(self, page: bytearray, now_s: float) -> None:
        motion = self._feel(now_s)
        units = self._config[0x3B]
        acceleration = 1000.0 / _G if units & 0x01 else 100.0
        rate = 900.0 if units & 0x02 else 16.0 * 180.0 / math.pi
        angle = 900.0 if units & 0x04 else 16.0 * 180.0 / math.pi
        heading, roll, pitch = motion.heading_roll_pitch_rad
        if units & 0x80:
            pitch = -pitch
        w, x, y, z = motion.quaternion
        up = (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z)
        gravity = [acceleration * _G * part for part in up]
        _put(page, 0x08, gravity)
        _put(page, 0x14, [rate * part for part in motion.gyro_rad_s])
        _put(page, 0x1A, [angle * part for part in (heading, roll, pitch)])
        _put(page, 0x20, [16_384.0 * part for part in motion.quaternion])
        _put(page, 0x2E, gravity)


def _put(page: bytearray, register: int, values: Sequence[float]) -> None:
    """Write numbers as words of two bytes, the low one first; what does not fit stands at the end of the range."""
    for number, value in enumerate(values):
        whole = max(-32_768, min(32_767, round(value))) & 0xFFFF
        page[register + 2 * number] = whole & 0xFF
        page[register + 2 * number + 1] = whole >> 8


_STEP_S = 0.01
_AGE_S = 0.01
"""One fusion period lies between what it feels and what its registers show."""
_TURNAROUND_S = 0.0003
_ASKED_S = 1.0
_STALE_S = 0.03
_PATIENCE_S = 0.03
"""A request that is still incomplete after this long is answered with a receive time-out."""
_WRONG_START, _TIME_OUT = 0x06, 0x0A
_GYRO_END_RAD_S = math.radians(2000.0)


class Bno055Emulator:
    """What it feels comes from the stand-in of a dry run, worked out anew every 10 ms.

    Chosen: it begins to answer 0.3 ms after a request, and is busy (over-run) while it changes its mode.

    Faults, besides those of the wire: ``overrun`` (share of the requests it is too busy for), ``error`` (status with
    which it answers everything), ``system-error`` (number of the error its registers show), ``wrong-id``, ``reset``
    (count: its supply fails for a moment), ``length`` (count: answers with a byte less than asked for),
    ``random-byte`` (count: a byte too many in an answer), ``off`` (a quaternion of half the length), ``jump`` (count:
    one reading turned by 90 deg), ``anew`` (degrees by which it has set its heading anew), ``saturate`` (gyroscope at
    the end of its range), ``own-angles`` (its Euler registers as real chips were seen to fill them).
    """

    def __init__(self, name: str, settings: SimulatedBno055Settings, context: EmulatorContext) -> None:
        self._clock = context.clock
        self._rng = context.rng
        self._faults = context.faults
        self._log = context.log
        self._line = PtyEndpoint(context, name, settings.baud)
        self._byte_s = 10.0 / settings.baud
        device = DeviceContext(clock=context.clock, rng=context.rng, scene=context.scene)
        self._sensor = SimulatedBno055(name, settings, device)
        self._chip = EmulatedChip(self._felt)
        self._felt_step = -1
        self._felt_values: FloatArray = np.zeros(11)
        self._read_s = -NEVER
        self._kept = bytearray()
        self._heard_s = -NEVER
        self._answers: deque[tuple[float, bytes]] = deque()

    def open(self) -> Mapping[str, Any]:
        """Open its port."""
        self._sensor.open()
        self._feel(self._clock.now())  # compiles what it takes, so that the first readings are not late
        return {"port": self._line.open()}

    def files(self) -> Sequence[int]:
        """Return what to wait on."""
        return self._line.fds

    def step(self, now_s: float) -> float:
        """Hear requests; send the answers that are due."""
        data = self._line.receive()
        if self._faults.take("reset"):
            self._log.note("reset")
            self._chip.boot(now_s)
        self._chip.chip_id = 0x86 if self._faults.active("wrong-id") else 0xA0
        self._chip.system_error = int(self._faults.number("system-error"))
        if data and self._chip.awake(now_s):
            self._heard_s = now_s
            self._kept += data
            self._take_requests(now_s)
        elif self._kept and now_s - self._heard_s > _PATIENCE_S:
            self._kept.clear()
            self._answer(bytes((0xEE, _TIME_OUT)), now_s, 0)
        while self._answers and self._answers[0][0] <= now_s:
            self._line.send(self._answers.popleft()[1])
        due_s = self._line.flush(now_s)
        if self._answers:
            due_s = min(due_s, self._answers[0][0])
        if self._kept:
            due_s = min(due_s, self._heard_s + _PATIENCE_S)
        # between requests, not within one: asking the bench takes its time
        if now_s - self._read_s < _ASKED_S:
            self._feel(now_s)
            due_s = min(due_s, (self._felt_step + 1) * _STEP_S)
        return due_s

    def close(self) -> None:
        """Close its port."""
        self._line.close()
        self._sensor.close()

    def _take_requests(self, now_s: float) -> None:
        kept = self._kept
        while kept:
            if kept[0] != 0xAA:
                begin = kept.find(0xAA)
                del kept[: begin if begin >= 0 else len(kept)]
                self._answer(bytes((0xEE, _WRONG_START)), now_s, 0)
                continue
            if len(kept) < 4:
                return
            size = 4 + (kept[3] if kept[1] == 0 and kept[3] <= 128 else 0)
            if len(kept) < size:
                return
            request = bytes(kept[:size])
            del kept[:size]
            self._answer(self._answer_to(request, now_s), now_s, size)

    def _answer(self, answer: bytes, now_s: float, request_bytes: int) -> None:
        if answer:
            self._answers.append((now_s + request_bytes * self._byte_s + _TURNAROUND_S, answer))

    def _answer_to(self, request: bytes, now_s: float) -> bytes:
        _, writes, register, count = request[:4]
        try:
            if self._faults.active("error"):
                raise Status(int(self._faults.number("error")))
            if self._rng.random() < self._faults.number("overrun"):
                raise Status(OVERRUN)
            if writes == 0:
                if count > 128:
                    raise Status(TOO_LONG)
                self._log.note("write", register=register, data=request[4:])
                return bytes((0xEE, self._chip.write(register, request[4:], now_s)))
            if writes != 1:
                raise Status(TOO_SHORT)
            data = self._chip.read(register, count, now_s)
        except Status as status:
            return bytes((0xEE, status.code))
        if self._faults.take("length"):
            data = data[:-1]
        answer = bytearray((0xBB, len(data))) + data
        if self._faults.take("random-byte"):
            answer.insert(int(self._rng.integers(len(answer) + 1)), int(self._rng.integers(256)))
        return bytes(answer)

    def _feel(self, now_s: float) -> None:
        """Do a step of the fusion if it is time."""
        step = math.floor(now_s / _STEP_S)
        if step > self._felt_step:
            self._felt_step = step
            self._felt_values = self._sensor.measure(np.array([step * _STEP_S - _AGE_S]))[0][0]

    def _felt(self, now_s: float) -> Motion:
        """Return what the latest step of the fusion has brought."""
        self._read_s = now_s
        if now_s - self._felt_step * _STEP_S > _STALE_S:
            self._feel(now_s)
        values = np.nan_to_num(self._felt_values, nan=1e6, posinf=1e6, neginf=-1e6)
        q, euler, gyro = values[:4], values[4:7], values[7:10]
        if self._faults.active("anew"):
            q = _turned_about_z(q, math.radians(self._faults.number("anew")))
        if self._faults.take("jump"):
            q = _turned_about_z(q, math.pi / 2)
        if self._faults.active("off"):
            q = 0.5 * q
        if self._faults.active("saturate"):
            gyro = np.full(3, _GYRO_END_RAD_S)
        if self._faults.active("own-angles"):
            euler = np.array([-euler[0] % (2 * math.pi), euler[2], euler[1]])
        return Motion(q.tolist(), euler.tolist(), gyro.tolist())


def _turned_about_z(q: FloatArray, angle_rad: float) -> FloatArray:
    """Return a quaternion turned about the room's vertical."""
    w, x, y, z = q
    c, s = math.cos(0.5 * angle_rad), math.sin(0.5 * angle_rad)
    return np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
