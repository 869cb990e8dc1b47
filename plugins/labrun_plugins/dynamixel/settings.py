"""What an experiment file may say about a bus of Dynamixels; driver and stand-in understand the same keys."""

from typing import ClassVar, Literal

from pydantic import Field, PositiveInt, field_validator, model_validator

from labrun.devices import Channel, DeviceSettings, Port
from labrun.toml import Keys

BAUD_CODES = {
    9_600: 0,
    57_600: 1,
    115_200: 2,
    1_000_000: 3,
    2_000_000: 4,
    3_000_000: 5,
    4_000_000: 6,
    4_500_000: 7,
}
"""Bits a second -> value of the servo's register Baud Rate."""
WATCHDOG_STEP_MS = 20
Quantity = Literal["angle", "speed", "current", "load"]
_UNITS: dict[Quantity, str] = {"angle": "rad", "speed": "rad/s", "current": "A", "load": "1"}


class Joint(Keys):
    """One servo: its id on the bus, its sense of rotation, and the servo angle at which the joint stands at zero.

    The servo's own angle is zero in the middle of its turn, at 2048 of 4096 counts.
    """

    id: int = Field(ge=0, le=252)
    sign: Literal[-1, 1] = 1
    neutral_deg: float = Field(default=0.0, ge=-180.0, le=180.0)


class DynamixelSettings(DeviceSettings):
    """Keys of the Dynamixel bus.

    Attributes
    ----------
    port
        Serial port.
    baud
        Bits a second, as set in the servos; 57 600 when new.
    joints
        Joint -> servo.
    operating_mode
        ``position`` covers one turn, ``extended-position`` up to 256 turns either way.
    command_hz
        Set-points a second.
    on_stop
        What a stop does: ``hold`` where the joint is, or ``torque-off``, on which a lifted load falls.
    watchdog_ms
        A servo that hears nothing for so long stops by itself; multiples of 20 ms, at least 40.
    return_delay_us
        How long a servo waits before it answers; set in the servos. 500 when new.
    position_gains
        P, I and D of the servo's position controller; None leaves those of the factory.
    feedback_hz
        Measurements a second as a stream of samples; 0 for none.
    feedback
        What the stream holds of each joint. Models without a current sensor measure ``load`` instead, a
        share of full PWM.
    """

    example: ClassVar[str] = """\
port   = "/dev/ttyUSB0"
baud   = 1_000_000                     # as set in the servos; 57 600 when new
joints = { joint_1 = { id = 1 }, joint_2 = { id = 2 } }      # joint -> id on the bus
feedback_hz = 100                      # measured angles, speeds and currents as a stream
limits = { angle_deg = [-90, 90], speed_deg_s = 180 }"""

    port: Port
    baud: PositiveInt = 1_000_000
    joints: dict[str, Joint] = Field(min_length=1)
    operating_mode: Literal["position", "extended-position"] = "position"
    command_hz: float = Field(default=100.0, gt=0.0, le=1000.0)
    on_stop: Literal["hold", "torque-off"] = "hold"
    watchdog_ms: int = Field(default=100, ge=2 * WATCHDOG_STEP_MS, le=127 * WATCHDOG_STEP_MS)
    return_delay_us: int = Field(default=0, ge=0, le=508)
    position_gains: tuple[int, int, int] | None = None
    feedback_hz: float = Field(default=0.0, ge=0.0, le=500.0)
    feedback: tuple[Quantity, ...] = Field(default=("angle", "speed", "current"), min_length=1)

    @field_validator("baud")
    @classmethod
    def _known_baud(cls, baud: int) -> int:
        if baud not in BAUD_CODES:
            raise ValueError(
                f"expected one of {', '.join(str(known) for known in BAUD_CODES)}, the rates of a Dynamixel"
            )
        return baud

    @field_validator("watchdog_ms", "return_delay_us")
    @classmethod
    def _whole_steps(cls, value: int, info: object) -> int:
        step = WATCHDOG_STEP_MS if getattr(info, "field_name", "") == "watchdog_ms" else 2
        if value % step:
            raise ValueError(f"expected a multiple of {step}, in which the servo counts")
        return value

    @field_validator("position_gains")
    @classmethod
    def _gains_fit(cls, gains: tuple[int, int, int] | None) -> tuple[int, int, int] | None:
        if gains is not None and not all(0 <= gain <= 16_383 for gain in gains):
            raise ValueError("expected P, I and D from 0 to 16383")
        return gains

    @field_validator("feedback")
    @classmethod
    def _each_once(cls, quantities: tuple[Quantity, ...]) -> tuple[Quantity, ...]:
        if len(set(quantities)) != len(quantities):
            raise ValueError("a quantity occurs twice; name each once")
        return quantities

    @model_validator(mode="after")
    def _ids_differ(self) -> "DynamixelSettings":
        owners: dict[int, str] = {}
        for joint, table in self.joints.items():
            other = owners.setdefault(table.id, joint)
            if other != joint:
                raise ValueError(
                    f"joints {other} and {joint} both have id {table.id}; give each servo an id of its own"
                )
        return self

    def channels(self) -> tuple[Channel, ...]:
        """Return the channels of the feedback stream, ``<joint>_<quantity>``; none without a stream."""
        if self.feedback_hz == 0.0:
            return ()
        return tuple(
            Channel(f"{joint}_{quantity}", _UNITS[quantity])
            for joint in self.joints
            for quantity in self.feedback
        )
