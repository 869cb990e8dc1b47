"""Readings of a BNO055 one after the other, whether they can be true (no checksum), and what they are in angles."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from labrun.devices import Channel, Clock, DeviceError, FloatArray, SampleBuffer
from labrun_plugins.bno055 import codec
from labrun_plugins.bno055.chip import Chip, Refused


def angles(quaternion: FloatArray) -> tuple[float, float, float]:
    """Return heading (0 ... 2 pi), roll (+-pi/2) and pitch (+-pi), rad, of a quaternion w, x, y, z of length 1.

    Heading is a turn about the body's z axis, roll about x, pitch about y, all right-handed and in that order:
    ``R = Rz(heading) Rx(roll) Ry(pitch)``. The chip's own Euler registers are not used: on real chips their heading has
    been seen to run the other way and their roll to be the turn about y (bdholt1/ros2_bno055_sensor, issue 3), and with
    firmware 03.11 they are distorted beyond some 20 deg of tilt (jetsonhacks/RTIMULib, pull request 1).
    """
    w, x, y, z = (float(part) for part in quaternion)
    heading = math.atan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z))
    roll = math.asin(max(-1.0, min(1.0, 2.0 * (y * z + w * x))))
    pitch = math.atan2(2.0 * (w * y - x * z), 1.0 - 2.0 * (x * x + y * y))
    return heading % (2.0 * math.pi), roll, pitch


def tilt(quaternion: FloatArray) -> float:
    """Return how far the body's z axis leans from the vertical, rad."""
    w, x, y, z = (float(part) for part in quaternion)
    return 2.0 * math.atan2(math.hypot(x, y), math.hypot(w, z))


def turn_between(first: FloatArray, other: FloatArray) -> float:
    """Return the angle (rad, 0 ... pi) by which two unit quaternions differ; q and -q are the same orientation."""
    return 2.0 * math.acos(min(1.0, abs(float(np.dot(first, other)))))


def up_in_body(quaternion: FloatArray) -> FloatArray:
    """Return the room's vertical as the body sees it, a unit vector."""
    w, x, y, z = (float(part) for part in quaternion)
    return np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])


CHANNELS = (
    Channel("qw", "1"), Channel("qx", "1"), Channel("qy", "1"), Channel("qz", "1"),
    Channel("heading", "rad"), Channel("roll", "rad"), Channel("pitch", "rad"),
    Channel("gyro_x", "rad/s"), Channel("gyro_y", "rad/s"), Channel("gyro_z", "rad/s"),
    Channel("tilt", "rad"),
)  # fmt: skip

_FAILURES = 5
_DOUBTS = 3
_ANSWER_S = 0.05
"""A reading that takes longer than this is given up: the next ones are newer."""
_OFF_S = 0.1
_LENGTH_TOLERANCE = 0.01
_RATE_SLACK = 1.5
_JUMP_SLACK_RAD = float(np.radians(3.0))
_STATE_EVERY_S = 2.0
_NAP_S = 0.004


def values_of(block: codec.Block) -> FloatArray:
    """Return the channels, shape (11,), of one reading whose quaternion has a length of about 1."""
    q = block.quaternion / np.linalg.norm(block.quaternion)
    return np.array([*block.quaternion, *angles(q), *block.gyro_rad_s, tilt(q)])


class _Seen(NamedTuple):
    time_s: float
    quaternion: FloatArray
    rate_rad_s: float


class Plausibility:
    """Judges readings by what a body can do.

    A reading that has turned further since the last one than the gyroscope tells is held back. If the next one agrees,
    it was no damaged byte but the chip that set its heading anew (mode "ndof" does), and the new orientation is
    believed.

    Parameters
    ----------
    jump_rad_s
        How much faster a turn may be than one and a half times what the gyroscope tells before or after it.

    Attributes
    ----------
    refused, corrections
        Readings not believed so far, and jumps of the chip that were.
    """

    def __init__(self, jump_rad_s: float) -> None:
        self._jump_rad_s = jump_rad_s
        self._last: _Seen | None = None
        self._doubted: _Seen | None = None
        self.refused = 0
        self.corrections = 0

    def doubt(self, block: codec.Block, time_s: float) -> str:
        """Return why a reading cannot be true; empty if it can."""
        length = float(np.linalg.norm(block.quaternion))
        if abs(length - 1.0) > _LENGTH_TOLERANCE:
            self.refused += 1
            self._doubted = None
            return f"its quaternion has a length of {length:.3g} instead of 1"
        here = _Seen(time_s, block.quaternion / length, float(np.linalg.norm(block.gyro_rad_s)))
        if self._near(self._last, here):
            self._last, self._doubted = here, None
            return ""
        if self._doubted is not None and self._near(self._doubted, here):
            self.corrections += 1
            self._last, self._doubted = here, None
            return ""
        self._doubted = here
        self.refused += 1
        return "it has turned faster than its gyroscope tells"

    def _near(self, before: _Seen | None, here: _Seen) -> bool:
        if before is None:
            return True
        rate_rad_s = _RATE_SLACK * max(before.rate_rad_s, here.rate_rad_s) + self._jump_rad_s
        allowed_rad = rate_rad_s * (here.time_s - before.time_s) + _JUMP_SLACK_RAD
        return turn_between(before.quaternion, here.quaternion) <= allowed_rad


class Sampling:
    """Takes readings at a rate. `receive` is for a thread of its own.

    Parameters
    ----------
    jump_rad_s
        As of `Plausibility`.
    told
        Gets the chip's state every two seconds.

    Attributes
    ----------
    readings, lost
        Good ones, and those that were due and brought nothing that could be believed.
    last_block
        The latest reading.
    """

    def __init__(
        self,
        device: str,
        chip: Chip,
        clock: Clock,
        buffer: SampleBuffer,
        *,
        rate_hz: float,
        jump_rad_s: float,
        note_state: Callable[[codec.State], None],
    ) -> None:
        self._device = device
        self._chip = chip
        self._clock = clock
        self._buffer = buffer
        self._period_s = 1.0 / rate_hz
        self._told = note_state
        self.plausibility = Plausibility(jump_rad_s)
        now_s = clock.now()
        self._due_s = now_s
        self._state_due_s = now_s + _STATE_EVERY_S
        self._failures = 0
        self._implausible = 0
        self._good_s = now_s
        self.began_s = now_s
        self.readings = 0
        self.lost = 0
        self.last_block: codec.Block | None = None

    def receive(self) -> None:
        """Wait for the next reading's time, a little at a time, and take it.

        Raises DeviceError: five readings in a row failed, or the quaternion was no unit quaternion for 0.1 s; or the
        port is gone.
        """
        left_s = self._due_s - self._clock.now()
        if left_s > 0.0:
            self._clock.sleep(min(left_s, _NAP_S))
            return
        self._due_s += self._period_s
        try:
            block = codec.block(self._chip.read(codec.BLOCK, codec.BLOCK_BYTES, within_s=_ANSWER_S))
        except Refused as refused:
            self._fail(refused)
            return
        now_s = self._clock.now()
        self._failures = 0
        doubt = self.plausibility.doubt(block, now_s)
        if doubt:
            self._disbelieve(doubt, now_s)
        else:
            self._implausible = 0
            self._good_s = now_s
            self.readings += 1
            self.last_block = block
            self._buffer.put(now_s, now_s, values_of(block), saturated=int(block.saturated))
        self._catch_up(now_s)
        if now_s >= self._state_due_s:
            self._ask_state(now_s)

    def _fail(self, refused: Refused) -> None:
        self._count(1)
        self._failures += 1
        if self._failures >= _FAILURES:
            raise DeviceError(
                self._device,
                f"{refused}; so did {_FAILURES} readings in a row",
                hint="check its supply and its cable; labrun resume sets it up again",
            )
        self._catch_up(self._clock.now())

    def _disbelieve(self, doubt: str, now_s: float) -> None:
        self._count(1)
        self._implausible += 1
        if self._implausible >= _DOUBTS and now_s - self._good_s > _OFF_S:
            raise DeviceError(
                self._device,
                f"its readings cannot be true for {now_s - self._good_s:.2g} s: {doubt}",
                hint="a length of 0 means that its supply failed for a moment, anything else a bad line: check both",
            )

    def _catch_up(self, now_s: float) -> None:
        """Leave out the readings whose time has passed: one that comes late is worth nothing."""
        behind = int((now_s - self._due_s) / self._period_s)
        if behind > 0:
            self._due_s += behind * self._period_s
            self._count(behind)

    def _ask_state(self, now_s: float) -> None:
        self._state_due_s = now_s + _STATE_EVERY_S
        try:
            self._told(self._chip.state())
        except Refused:
            return  # the readings tell whether it lives

    def _count(self, lost: int) -> None:
        self.lost += lost
        self._buffer.count_lost(lost)
