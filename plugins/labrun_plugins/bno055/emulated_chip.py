"""The inside of an emulated BNO055: its registers, its modes and how long it takes to change them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
