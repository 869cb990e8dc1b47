"""What an experiment file says about RC servos on an Arduino; from joint angles to pulse widths, and back."""

from collections.abc import Mapping
from typing import ClassVar, Literal, TypeVar

import numpy as np
from pydantic import Field, NonNegativeFloat, NonNegativeInt, model_validator

from labrun.devices import DeviceError, DeviceSettings, FloatArray, Limits, Port, Trajectory
from labrun.errors import LimitExceededError
from labrun.toml import Keys

KIND = "labservo"
"""What the firmware says it is."""
NEUTRAL_US = 1500.0
"""Pulse width at which a servo stands in the middle of its range."""
PULSE_US = (500, 2500)
"""Pulse widths of the firmware: no servo takes others."""


class Joint(Keys):
    """One servo.

    Attributes
    ----------
    pin
        Arduino pin of its signal wire; may be left out if the joints stand in the order of the firmware's channels.
    sign
        -1 for a servo that is mounted the other way round.
    neutral_deg
        Servo angle at which the joint stands at zero.
    us_per_deg
        Change of pulse width for a degree; 10 for most servos. Measure it.
    pulse_us
        Least and greatest pulse width the servo gets, whatever the limits of the angle.
    """

    pin: NonNegativeInt | None = None
    sign: Literal[-1, 1] = 1
    neutral_deg: float = Field(default=0.0, ge=-90.0, le=90.0)
    us_per_deg: float = Field(default=10.0, gt=0.0, le=100.0)
    pulse_us: tuple[int, int] = PULSE_US

    @model_validator(mode="after")
    def _pulses_ascend(self) -> "Joint":
        low, high = self.pulse_us
        if not PULSE_US[0] <= low < high <= PULSE_US[1]:
            raise ValueError(f"expected pulse_us = [low, high] within {PULSE_US[0]} ... {PULSE_US[1]} us")
        return self

    def exact_pulse_us(self, angle_deg: FloatArray) -> FloatArray:
        """Return the pulse widths of joint angles (deg), us, before they are rounded to whole ones."""
        return NEUTRAL_US + self.us_per_deg * (self.sign * angle_deg + self.neutral_deg)

    def angle_deg(self, pulse_us: float) -> float:
        """Return the joint's angle at a pulse width, deg."""
        return self.sign * self.servo_deg(pulse_us)

    def servo_deg(self, pulse_us: float) -> float:
        """Return how far the servo has turned from where the joint stands at zero, deg, in the servo's own sense."""
        return (pulse_us - NEUTRAL_US) / self.us_per_deg - self.neutral_deg

    def pulse_window_us(self, angle_deg: tuple[float, float] | None) -> tuple[int, int]:
        """Return the pulse widths that limits of the angle (deg) leave, as the firmware is told: whole us."""
        low, high = self.pulse_us
        if angle_deg is None:
            return low, high
        ends = [NEUTRAL_US + self.us_per_deg * (self.sign * end + self.neutral_deg) for end in angle_deg]
        return max(low, round(min(ends))), min(high, round(max(ends)))


class BoardSettings(DeviceSettings):
    """Keys of a board with the firmware `labservo`, whatever its servos move.

    Attributes
    ----------
    port
        Serial port of the board.
    watchdog_ms
        Without a good line for so long during a motion the board stops by itself.
    rate_hz
        Set-points a second; a servo takes 50 at most.
    boot_wait_s
        How long the board may take to come up after its port was opened; 0 for a board that opening does not reset.
    """

    port: Port
    watchdog_ms: int = Field(default=100, ge=20, le=5000)
    rate_hz: float = Field(default=50.0, gt=0.0, le=50.0)
    boot_wait_s: NonNegativeFloat = Field(default=3.0, le=10.0)


class ArduinoServoSettings(BoardSettings):
    """Keys of RC servos on an Arduino, besides those of its board.

    Attributes
    ----------
    joints
        Joint -> servo; may be left out if there is one servo, whose joint is called like the device.
    pins
        Pins of the firmware's channels, in their order (the table PINS of labservo.ino).
    """

    example: ClassVar[str] = """\
port   = "/dev/ttyACM0"
joints = { joint_1 = { pin = 3 } }     # joint -> pin of its servo
limits = { angle_deg = [-60, 60], speed_deg_s = 400 }"""

    joints: dict[str, Joint] | None = Field(default=None, min_length=1)
    pins: tuple[NonNegativeInt, ...] = Field(default=(3, 5, 6, 9), min_length=1, max_length=12)

    @model_validator(mode="after")
    def _channels_differ(self) -> "ArduinoServoSettings":
        if len(set(self.pins)) != len(self.pins):
            raise ValueError(f"pins: {self.pins} names a pin twice")
        if self.joints is not None:
            channels_of(self.joints, self.pins)
        return self

    @model_validator(mode="after")
    def _limits_leave_pulses(self) -> "ArduinoServoSettings":
        for joint, table in (self.joints or {}).items():
            low, high = table.pulse_window_us(self.limits.angle_deg)
            if low >= high:
                raise ValueError(f"limits.angle_deg and pulse_us of {joint} have no pulse width in common")
        return self


def channels_of(joints: Mapping[str, Joint], pins: tuple[int, ...]) -> dict[str, int]:
    """Return the firmware's channel of each joint: by its pin, or by its place if no joint names a pin.

    Raises ValueError: a pin the firmware does not drive, one of two joints, or more joints than channels.
    """
    named = {joint: table.pin for joint, table in joints.items() if table.pin is not None}
    if not named:
        if len(joints) > len(pins):
            raise ValueError(
                f"{len(joints)} joints are more than the {len(pins)} pins that the firmware drives: {pins}"
            )
        return {joint: number for number, joint in enumerate(joints)}
    channels: dict[str, int] = {}
    for joint in joints:
        pin = named.get(joint)
        if pin is None:
            raise ValueError(
                f"joint {joint} names no pin, but other joints do; name a pin for each, or for none"
            )
        if pin not in pins:
            raise ValueError(f"pin {pin} of joint {joint} is not one of the firmware's pins {pins}")
        other = next((name for name, channel in channels.items() if pins[channel] == pin), None)
        if other is not None:
            raise ValueError(f"joints {other} and {joint} both have pin {pin}; give each a pin of its own")
        channels[joint] = pins.index(pin)
    return channels


Value = TypeVar("Value")
_HINT = "set limits.angle_deg, so that the plan is refused before anything moves"


class Pulses:
    """Pulse widths of one board's servos.

    Parameters
    ----------
    channels
        Joint -> channel of the firmware.
    """

    def __init__(
        self, device: str, tables: Mapping[str, Joint], channels: Mapping[str, int], limits: Limits
    ) -> None:
        self._device = device
        self._tables = dict(tables)
        self._limits = limits
        self.joints = tuple(tables)
        self.channels = dict(channels)
        self.windows_us = {
            joint: table.pulse_window_us(limits.angle_deg) for joint, table in self._tables.items()
        }
        """Least and greatest pulse width of each joint, us."""

    def check(self, trajectory: Trajectory) -> None:
        """Refuse a motion that leaves a limit anywhere.

        Raises
        ------
        LimitExceededError
            It leaves the file's limits.
        DeviceError
            Other joints, or pulse widths that a servo does not take.
        """
        if trajectory.joints != self.joints:
            raise DeviceError(
                self._device,
                f"got a motion of {', '.join(trajectory.joints)}, but drives {', '.join(self.joints)}",
            )
        self._limits.require_motion(self._device, trajectory)
        for joint, angle_rad in zip(self.joints, trajectory.angle_rad.T, strict=True):
            pulse_us = self._tables[joint].exact_pulse_us(np.degrees(angle_rad))
            low_us, high_us = self._tables[joint].pulse_us
            if pulse_us.min() < low_us - 0.5 or pulse_us.max() > high_us + 0.5:
                raise DeviceError(
                    self._device,
                    f"pulses of {pulse_us.min():.0f} to {pulse_us.max():.0f} us for {joint} leave "
                    f"{low_us} to {high_us} us; nothing was sent",
                    hint=_HINT,
                )

    def of(self, angle_rad: FloatArray) -> dict[str, int]:
        """Return the pulse width of each joint for one set-point (rad, in the order of `joints`), us.

        Raises LimitExceededError: one of them is outside its limits, or not a number: the set-point must not be sent.
        """
        pulses: dict[str, int] = {}
        for joint, angle in zip(self.joints, np.degrees(angle_rad), strict=True):
            exact_us = float(self._tables[joint].exact_pulse_us(angle))
            low_us, high_us = self.windows_us[joint]
            if not low_us - 0.5 <= exact_us <= high_us + 0.5:
                raise LimitExceededError(
                    self._device,
                    f"a set-point of {angle:.4g} deg for {joint} asks for a pulse of {exact_us:.0f} us, outside of "
                    f"{low_us} to {high_us} us; it was not sent",
                    hint=_HINT,
                )
            pulses[joint] = min(max(round(exact_us), low_us), high_us)
        return pulses

    def by_channel(self, values: Mapping[str, Value]) -> dict[int, Value]:
        """Return what belongs to joints by their channels."""
        return {self.channels[joint]: value for joint, value in values.items()}

    def rest_us(self) -> dict[str, int]:
        """Return the pulse width of each joint at zero, or as near to it as its limits allow, us."""
        rest: dict[str, int] = {}
        for joint, table in self._tables.items():
            low_us, high_us = self.windows_us[joint]
            rest[joint] = min(max(round(NEUTRAL_US + table.us_per_deg * table.neutral_deg), low_us), high_us)
        return rest

    def angles_rad(self, pulses_us: Mapping[int, int]) -> dict[str, float]:
        """Return the joint angles that the channels' pulse widths ask for, rad."""
        return {
            joint: float(np.radians(self._tables[joint].angle_deg(pulses_us[channel])))
            for joint, channel in self.channels.items()
        }
