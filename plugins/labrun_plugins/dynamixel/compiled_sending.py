"""Set-points as machine code sends them: limits, counts, sync write with stuffing and check sum.

Every so often the question where the servos are goes with them; the driver's own thread hears the answers.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from labrun.devices import FloatArray
from labrun.devices.compiled import (
    BEYOND,
    BUSY,
    FREE_S,
    GONE,
    HALT,
    HALTED,
    NOT_TAKEN,
    SENT,
    TOO_LATE,
    CompiledWire,
    Pointer,
    kernel,
    native,
)
from labrun.devices.system_calls import write_bytes
from labrun_plugins.dynamixel.codec import CRC_TABLE, SYNC_WRITE
from labrun_plugins.dynamixel.commands import SPEED_SLACK
from labrun_plugins.dynamixel.control_table import CENTRE, COUNT_RAD, GOAL_POSITION, MOTION, Scale
from labrun_plugins.dynamixel.settings import DynamixelSettings

CALLS, _SENT_S, ANGLES = 3, 4, 5
"""Places of the state: set-points asked for, when the last one left, and what it was."""
_FILE, _JOINTS, _LOW, _HIGH, _SPEED, _PERIOD, _WATCHDOG, _EVERY, _QUESTION, _BYTE_S, _ANSWER_S, _ROWS = range(
    12
)
_ID, _SIGN, _NEUTRAL, _LEAST, _MOST, _ROW = range(6)
_CRC = np.array(CRC_TABLE, dtype=np.int64)
_ADDRESS, _SIZE = GOAL_POSITION.address, GOAL_POSITION.size
_BODY = 7
_BITS = 10
_AROUND_DATA = 11
"""Bytes of a status packet beside its data."""


def wire_of(
    file: int,
    settings: DynamixelSettings,
    scales: Sequence[tuple[int, Scale]],
    angles_rad: FloatArray,
    rate_hz: float,
    question: bytes,
    now_s: float,
) -> CompiledWire:
    """Return how a loop sends the set-points of a bus.

    Parameters
    ----------
    file
        Descriptor of the port.
    scales
        Id and scale of each joint, in the loop's order.
    angles_rad : (joints,)
        Where they are.
    rate_hz
        Of the loop.
    question
        The packet that asks where the servos are; sent `DynamixelSettings.feedback_hz` times a second.
    now_s
        When something was sent last.
    """
    limits = settings.limits
    low, high = (-math.inf, math.inf) if limits.angle_deg is None else np.radians(limits.angle_deg)
    speed = math.inf if limits.speed_deg_s is None else math.radians(limits.speed_deg_s)
    every = max(1, math.ceil(rate_hz / settings.feedback_hz - 1e-9)) if question else 0
    rows = [
        number for identity, one in scales for number in (identity, one.sign, one.neutral_rad, *one.bounds)
    ]
    byte_s = _BITS / settings.baud
    answer_s = len(scales) * ((_AROUND_DATA + MOTION.size) * byte_s + 1e-6 * settings.return_delay_us)
    parameters = np.array(
        [
            file, len(scales), low, high, SPEED_SLACK * speed, 1.0 / rate_hz, 1e-3 * settings.watchdog_ms, every,
            len(question), byte_s, answer_s, *rows, *question,
        ],
        dtype=float,
    )  # fmt: skip
    state = np.array([0.0, 0.0, now_s, 0.0, now_s, *angles_rad], dtype=float)
    return CompiledWire(SENDING.address, state, parameters)


def asked(wire: CompiledWire) -> int:
    """Return how often the servos were asked where they are."""
    every = wire.parameters[_EVERY]
    return int(wire.state[CALLS] // every) if every else 0


def _send(t: float, x: Pointer, u: Pointer, p: Pointer, force: Pointer, out: Pointer) -> None:  # noqa: ARG001
    """Send one set-point, see `CompiledWire.send`."""
    x[BUSY] = 1.0
    out[0] = HALTED if x[HALT] != 0.0 else _sent(t, x, u, p)
    x[BUSY] = 0.0


SENDING = native("model", _send)


@kernel
def _sent(t: float, x: Pointer, u: Pointer, p: Pointer) -> int:
    joints = int(p[_JOINTS])
    passed_s = t - x[_SENT_S]
    if passed_s > p[_WATCHDOG]:
        return TOO_LATE
    for j in range(joints):
        if not p[_LOW] - 1e-9 <= u[j] <= p[_HIGH] + 1e-9:
            return BEYOND
        if abs(u[j] - x[ANGLES + j]) > p[_SPEED] * (passed_s + p[_PERIOD]) + COUNT_RAD:
            return BEYOND
    packet = np.empty(32 + 8 * joints + int(p[_QUESTION]), dtype=np.uint8)
    end = _sync_write(packet, u, p, joints)
    x[CALLS] += 1.0
    answer_s = 0.0
    if p[_EVERY] > 0.0 and x[CALLS] % p[_EVERY] == 0.0:
        begin = _ROWS + _ROW * joints
        for i in range(int(p[_QUESTION])):
            packet[end + i] = np.uint8(p[begin + i])
        end += int(p[_QUESTION])
        answer_s = p[_ANSWER_S]
    written = write_bytes(int(p[_FILE]), packet, end)
    if written == 0:
        return NOT_TAKEN
    if written < 0:
        return GONE
    x[_SENT_S] = t
    x[FREE_S] = max(t, x[FREE_S]) + end * p[_BYTE_S] + answer_s
    for j in range(joints):
        x[ANGLES + j] = u[j]
    return SENT


@kernel
def _sync_write(packet: Any, u: Pointer, p: Pointer, joints: int) -> int:
    """Write the goals of all joints as one packet; return its length."""
    packet[0], packet[1], packet[2], packet[3], packet[4] = 0xFF, 0xFF, 0xFD, 0x00, 0xFE
    packet[_BODY] = SYNC_WRITE
    packet[8], packet[9], packet[10], packet[11] = _ADDRESS, 0, _SIZE, 0
    end = 12
    for j in range(joints):
        row = _ROWS + _ROW * j
        packet[end] = np.uint8(p[row + _ID])
        end += 1
        goal = CENTRE + round((p[row + _SIGN] * u[j] + p[row + _NEUTRAL]) / COUNT_RAD)
        goal = int(min(max(goal, p[row + _LEAST]), p[row + _MOST]))
        for byte in range(_SIZE):
            packet[end] = (goal >> (8 * byte)) & 0xFF
            end += 1
            if packet[end - 3] == 0xFF and packet[end - 2] == 0xFF and packet[end - 1] == 0xFD:
                packet[end] = 0xFD
                end += 1
    length = end - _BODY + 2
    packet[5], packet[6] = length & 0xFF, length >> 8
    crc = 0
    for i in range(end):
        crc = ((crc << 8) ^ _CRC[(crc >> 8) ^ packet[i]]) & 0xFFFF
    packet[end], packet[end + 1] = crc & 0xFF, crc >> 8
    return end + 2
