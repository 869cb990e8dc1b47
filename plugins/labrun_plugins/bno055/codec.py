"""Bytes of a BNO055 on its serial line, and what they stand for. Nothing here touches a port.

Source: data sheet BST-BNO055-DS000-14, section 4.7 and register map; application note AN012.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from labrun.devices import FloatArray

CHIP_ID = 0xA0
IDS, PAGE, GYRO, EULER, QUATERNION, GRAVITY = 0x00, 0x07, 0x14, 0x1A, 0x20, 0x2E
TEMPERATURE, CALIBRATION, SYSTEM_STATUS, UNITS, MODE, TRIGGER, OFFSETS = (
    0x34,
    0x35,
    0x39,
    0x3B,
    0x3D,
    0x3F,
    0x55,
)
BLOCK, BLOCK_BYTES = GYRO, 32
"""Gyroscope, Euler angles, quaternion, linear acceleration and gravity in one transfer, all of one fusion step."""
STATE, STATE_BYTES = TEMPERATURE, 7
CONFIG_MODE = 0x00
FUSION_MODE = {"imu": 0x08, "ndof": 0x0C}
DEGREES = 0x00
"""Unit select: m/s^2, deg/s, deg, degC, pitch as Windows has it; written, because boards differ in their defaults."""
EXTERNAL_CRYSTAL, RESET = 0x80, 0x20

WRITTEN, OVERRUN = 0x01, 0x07
STATUS = {
    0x01: "written",
    0x02: "read failed",
    0x03: "write failed",
    0x04: "no such register",
    0x05: "register cannot be written",
    0x06: "wrong start byte",
    0x07: "bus over-run",
    0x08: "message too long",
    0x09: "message too short",
    0x0A: "receive time-out",
}
_READ_ANSWER, _STATUS_ANSWER = 0xBB, 0xEE

_QUATERNION_STEP = 2.0**-14
_RATE_STEP_RAD_S = float(np.radians(1.0 / 16.0))
_ANGLE_STEP_RAD = float(np.radians(1.0 / 16.0))
_ACCELERATION_STEP = 0.01
_GYRO_END_COUNTS = 32_000
"""2000 deg/s."""


def read_request(register: int, count: int) -> bytes:
    """Return the message that asks for `count` bytes from `register` on."""
    return bytes((0xAA, 0x01, register, count))


def write_request(register: int, data: bytes) -> bytes:
    """Return the message that writes bytes from `register` on."""
    return bytes((0xAA, 0x00, register, len(data))) + data


@dataclass(frozen=True, slots=True)
class Answer:
    """What came for a request.

    Attributes
    ----------
    kind
        ``data``, ``status``; ``damaged``: bytes came that are no answer, or more than one; ``none``: nothing came yet.
    data
        Of a reading.
    status
        Of a refusal, or of a writing.
    """

    kind: Literal["data", "status", "damaged", "none"]
    data: bytes = b""
    status: int = 0


_NOT_YET = Answer("none")
_DAMAGED = Answer("damaged")


def answer_to_read(heard: bytes, count: int) -> Answer:
    """Return what the bytes heard since a request for `count` bytes are.

    There is no checksum: only exactly what was asked for, and nothing before or after it, is taken for an answer.
    """
    if not heard:
        return _NOT_YET
    if heard[0] == _STATUS_ANSWER:
        return _status(heard)
    if heard[0] != _READ_ANSWER or (len(heard) > 1 and heard[1] != count) or len(heard) > 2 + count:
        return _DAMAGED
    return Answer("data", data=heard[2:]) if len(heard) == 2 + count else _NOT_YET


def answer_to_write(heard: bytes) -> Answer:
    """Return what the bytes heard since a request to write are."""
    if not heard:
        return _NOT_YET
    return _status(heard) if heard[0] == _STATUS_ANSWER else _DAMAGED


def _status(heard: bytes) -> Answer:
    if len(heard) < 2:
        return _NOT_YET
    return Answer("status", status=heard[1]) if len(heard) == 2 and heard[1] in STATUS else _DAMAGED


def _words(data: bytes, begin: int, count: int) -> FloatArray:
    return np.frombuffer(data, dtype="<i2", count=count, offset=begin).astype(float)


class Block(NamedTuple):
    """One fusion step, in SI units; `euler_rad` are heading, roll and pitch as the chip itself works them out."""

    gyro_rad_s: FloatArray
    euler_rad: FloatArray
    quaternion: FloatArray
    gravity_m_s2: FloatArray
    saturated: bool


def block(data: bytes) -> Block:
    """Return the values of the 32 bytes from register 14 on; ValueError if they are not 32."""
    if len(data) != BLOCK_BYTES:
        raise ValueError(f"a block has {BLOCK_BYTES} bytes, and these are {len(data)}")
    gyro = _words(data, 0, 3)
    return Block(
        gyro_rad_s=gyro * _RATE_STEP_RAD_S,
        euler_rad=_words(data, EULER - BLOCK, 3) * _ANGLE_STEP_RAD,
        quaternion=_words(data, QUATERNION - BLOCK, 4) * _QUATERNION_STEP,
        gravity_m_s2=_words(data, GRAVITY - BLOCK, 3) * _ACCELERATION_STEP,
        saturated=bool(np.max(np.abs(gyro)) >= _GYRO_END_COUNTS),
    )


class State(NamedTuple):
    """How the chip is: temperature (degC), calibration 0 ... 3 of system, gyroscope, accelerometer and magnetometer."""

    temperature_c: float
    calibration: tuple[int, int, int, int]
    status: int
    error: int


def state(data: Sequence[int]) -> State:
    """Return the values of the seven bytes from register 34 on; ValueError if they are not seven."""
    if len(data) != STATE_BYTES:
        raise ValueError(f"the state has {STATE_BYTES} bytes, and these are {len(data)}")
    temperature, calibration = data[0], data[1]
    levels = (calibration >> 6 & 3, calibration >> 4 & 3, calibration >> 2 & 3, calibration & 3)
    return State(float(temperature - 256 if temperature > 127 else temperature), levels, data[5], data[6])
