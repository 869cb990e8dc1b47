"""What an experiment file says about RC servos on an Arduino."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, NonNegativeInt, model_validator

from labrun.devices import DeviceSettings, FloatArray, Port

KIND = "labservo"
"""What the firmware says it is."""
NEUTRAL_US = 1500.0
"""Pulse width at which a servo stands in the middle of its range."""
PULSE_US = (500, 2500)
"""Pulse widths of the firmware: no servo takes others."""


class Joint(BaseModel):
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

    model_config = ConfigDict(extra="forbid", frozen=True)

    pin: NonNegativeInt | None = None
    sign: Literal[-1, 1] = 1
    neutral_deg: float = Field(default=0.0, ge=-90.0, le=90.0)
    us_per_deg: float = Field(default=10.0, gt=0.0, le=100.0)
    pulse_us: tuple[int, int] = PULSE_US

    @model_validator(mode="after")
    def _pulses_ascend(self) -> "Joint":
        low, high = self.pulse_us
        if not PULSE_US[0] <= low < high <= PULSE_US[1]:
            raise ValueError(f"pulse_us: [low, high] within {PULSE_US[0]} ... {PULSE_US[1]} us")
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

    Raises
    ------
    ValueError
        A pin the firmware does not drive, one of two joints, or more joints than channels.
    """
    named = {joint: table.pin for joint, table in joints.items() if table.pin is not None}
    if not named:
        if len(joints) > len(pins):
            raise ValueError(f"{len(joints)} joints, and the firmware drives {len(pins)} pins: {pins}")
        return {joint: number for number, joint in enumerate(joints)}
    channels: dict[str, int] = {}
    for joint in joints:
        pin = named.get(joint)
        if pin is None:
            raise ValueError(f"joint {joint} names no pin, and others do")
        if pin not in pins:
            raise ValueError(f"pin {pin} of joint {joint} is none of the firmware's pins {pins}")
        other = next((one for one, channel in channels.items() if pins[channel] == pin), None)
        if other is not None:
            raise ValueError(f"joints {other} and {joint} both have pin {pin}")
        channels[joint] = pins.index(pin)
    return channels
