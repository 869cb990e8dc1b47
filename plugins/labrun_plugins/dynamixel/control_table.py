"""The control table of the X series as data, what differs between models, how a joint's angle is counted.

Sources: ROBOTIS e-Manual, pages of the models. Another model of the series is one more line in `MODELS`.
"""

import math
from dataclasses import dataclass

from labrun.devices import Limits
from labrun_plugins.dynamixel.settings import DynamixelSettings, Joint

COUNT_RAD = 2.0 * math.pi / 4096
"""One count of position."""
CENTRE = 2048
"""Count at which a servo stands in the middle of its turn."""
SPEED_UNIT_RAD_S = 0.229 * 2.0 * math.pi / 60.0
LOAD_UNIT = 1e-3
"""One step of Present Load, as a share of full PWM."""
VOLTAGE_UNIT_V = 0.1
TURNS = 256
"""Extended position mode counts this many turns either way."""
TRIPPED = 0xFF
"""What Bus Watchdog reads after it has stopped the servo."""
FAST_FIRMWARE = 45
"""From this firmware on a servo answers fast reads."""
WATCHDOG_FIRMWARE = 38
TICK_PERIOD_S = 32.768
"""Realtime Tick counts milliseconds from 0 to 32 767."""


@dataclass(frozen=True, slots=True)
class Register:
    """One entry of the control table."""

    name: str
    address: int
    size: int
    signed: bool = False

    def decode(self, data: bytes) -> int:
        """Return the value in little-endian bytes."""
        return int.from_bytes(data, "little", signed=self.signed)

    def encode(self, value: int) -> bytes:
        """Return a value as little-endian bytes."""
        return value.to_bytes(self.size, "little", signed=self.signed)

    def within(self, block: "Block", data: bytes) -> int:
        """Return the value in the bytes of a block that holds this register."""
        start = self.address - block.address
        return self.decode(data[start : start + self.size])


@dataclass(frozen=True, slots=True)
class Block:
    """Neighbouring registers that are read in one go."""

    address: int
    size: int


MODEL_NUMBER = Register("Model Number", 0, 2)
FIRMWARE = Register("Firmware Version", 6, 1)
RETURN_DELAY = Register("Return Delay Time", 9, 1)
DRIVE_MODE = Register("Drive Mode", 10, 1)
OPERATING_MODE = Register("Operating Mode", 11, 1)
HOMING_OFFSET = Register("Homing Offset", 20, 4, signed=True)
TEMPERATURE_LIMIT = Register("Temperature Limit", 31, 1)
VELOCITY_LIMIT = Register("Velocity Limit", 44, 4)
MAX_POSITION = Register("Max Position Limit", 48, 4)
MIN_POSITION = Register("Min Position Limit", 52, 4)
SHUTDOWN = Register("Shutdown", 63, 1)
TORQUE_ENABLE = Register("Torque Enable", 64, 1)
STATUS_LEVEL = Register("Status Return Level", 68, 1)
HARDWARE_ERROR = Register("Hardware Error Status", 70, 1)
POSITION_D = Register("Position D Gain", 80, 2)
POSITION_I = Register("Position I Gain", 82, 2)
POSITION_P = Register("Position P Gain", 84, 2)
BUS_WATCHDOG = Register("Bus Watchdog", 98, 1)
GOAL_PWM = Register("Goal PWM", 100, 2, signed=True)
GOAL_CURRENT = Register("Goal Current", 102, 2, signed=True)
GOAL_VELOCITY = Register("Goal Velocity", 104, 4, signed=True)
PROFILE_ACCELERATION = Register("Profile Acceleration", 108, 4)
PROFILE_VELOCITY = Register("Profile Velocity", 112, 4)
GOAL_POSITION = Register("Goal Position", 116, 4, signed=True)
TICK = Register("Realtime Tick", 120, 2)
PRESENT_CURRENT = Register("Present Current", 126, 2, signed=True)
PRESENT_VELOCITY = Register("Present Velocity", 128, 4, signed=True)
PRESENT_POSITION = Register("Present Position", 132, 4, signed=True)
INPUT_VOLTAGE = Register("Present Input Voltage", 144, 2)
TEMPERATURE = Register("Present Temperature", 146, 1)

MOTION = Block(120, 16)
"""From Realtime Tick to Present Position."""
STOP = Block(108, 12)
"""From Profile Acceleration over Profile Velocity to Goal Position."""
CLIMATE = Block(144, 3)
"""Voltage and temperature."""


def whole(register: Register) -> Block:
    """Return a register as a block of its own."""
    return Block(register.address, register.size)


MODES = {"current": 0, "velocity": 1, "position": 3, "extended-position": 4, "current-position": 5, "pwm": 16}

HARDWARE_ERRORS = {
    0: "input voltage outside its limits",
    2: "overheating",
    3: "motor encoder",
    4: "electrical shock or too little power",
    5: "overload: more current than it can bear for long",
}
"""Bit of Hardware Error Status -> what it means."""

REFUSALS = {
    1: "failed to carry it out",
    2: "does not know this instruction",
    3: "heard it with a wrong check sum",
    4: "says that the value is out of range",
    5: "says that the length is wrong",
    6: "says that the value is beyond its limit",
    7: "grants no access: read-only, no such address, or EEPROM while the torque is on",
}
"""Number in the error byte of a status packet -> what it means."""


@dataclass(frozen=True, slots=True)
class Model:
    """What differs between models.

    Attributes
    ----------
    name
        As on the label.
    current_a
        One step of current, A; None for a model that measures load instead.
    """

    name: str
    current_a: float | None


_LOAD = None
MODELS: dict[int, Model] = {
    1000: Model("XH430-W350", 2.69e-3),
    1001: Model("XD430-T350", 2.69e-3),
    1010: Model("XH430-W210", 2.69e-3),
    1011: Model("XD430-T210", 2.69e-3),
    1020: Model("XM430-W350", 2.69e-3),
    1030: Model("XM430-W210", 2.69e-3),
    1040: Model("XH430-V350", 1.34e-3),
    1050: Model("XH430-V210", 1.34e-3),
    1060: Model("XL430-W250", _LOAD),
    1070: Model("XC430-W150", _LOAD),
    1080: Model("XC430-W240", _LOAD),
    1090: Model("2XL430-W250", _LOAD),
    1100: Model("XH540-W270", 2.69e-3),
    1110: Model("XH540-W150", 2.69e-3),
    1120: Model("XM540-W270", 2.69e-3),
    1130: Model("XM540-W150", 2.69e-3),
    1140: Model("XH540-V270", 2.69e-3),
    1150: Model("XH540-V150", 2.69e-3),
    1160: Model("2XC430-W250", _LOAD),
    1170: Model("XW540-T260", 2.69e-3),
    1180: Model("XW540-T140", 2.69e-3),
    1190: Model("XL330-M077", 1e-3),
    1200: Model("XL330-M288", 1e-3),
    1210: Model("XC330-T181", 1e-3),
    1220: Model("XC330-T288", 1e-3),
    1230: Model("XC330-M181", 1e-3),
    1240: Model("XC330-M288", 1e-3),
    1270: Model("XW430-T333", 2.69e-3),
    1280: Model("XW430-T200", 2.69e-3),
}
"""Model number -> model. All of them share the registers above and 4096 counts a turn."""


def hardware_errors(status: int) -> list[str]:
    """Return what Hardware Error Status says, one phrase a bit."""
    return [
        HARDWARE_ERRORS.get(bit, f"error bit {bit}, which the manual does not name")
        for bit in range(8)
        if status >> bit & 1
    ]


_POSITION_REACH = (0, 4095)
_EXTENDED_REACH = (-TURNS * 4096 + 1, TURNS * 4096 - 1)


@dataclass(frozen=True, slots=True)
class Scale:
    """How one joint's angle is counted.

    Attributes
    ----------
    sign, neutral_rad
        Servo angle = sign * joint angle + neutral; its zero is count 2048.
    reach
        Lowest and highest count of the operating mode.
    bounds
        Lowest and highest count that the limits allow, inside the reach.
    """

    sign: int
    neutral_rad: float
    reach: tuple[int, int]
    bounds: tuple[int, int]

    @classmethod
    def of(cls, joint: Joint, settings: DynamixelSettings) -> "Scale":
        """Return the scale of a joint of these settings."""
        reach = _POSITION_REACH if settings.operating_mode == "position" else _EXTENDED_REACH
        free = cls(int(joint.sign), math.radians(joint.neutral_deg), reach, reach)
        return cls(free.sign, free.neutral_rad, reach, free._bounds(settings.limits))

    def count(self, angle_rad: float) -> int:
        """Return the count nearest to a joint angle, inside the bounds: half a turn is one count beyond the last."""
        low, high = self.bounds
        return min(max(self._count(angle_rad), low), high)

    def angle_rad(self, count: int) -> float:
        """Return the joint angle of a count."""
        return self.sign * ((count - CENTRE) * COUNT_RAD - self.neutral_rad)

    def turns(self, angle_rad: float) -> float:
        """Return how far from its middle a joint angle turns the servo, in turns."""
        return abs(self.sign * angle_rad + self.neutral_rad) / (2.0 * math.pi)

    def inside(self, count: int) -> int:
        """Return the count nearest to this one that the limits allow."""
        low, high = self.bounds
        return min(max(count, low), high)

    def _count(self, angle_rad: float) -> int:
        return CENTRE + round((self.sign * angle_rad + self.neutral_rad) / COUNT_RAD)

    def _bounds(self, limits: Limits) -> tuple[int, int]:
        low, high = self.reach
        if limits.angle_deg is None:
            return self.reach
        ends = sorted(self._exact(math.radians(angle)) for angle in limits.angle_deg)
        # Inwards, so that no whole count lies outside the limit.
        first, last = math.ceil(ends[0] - 1e-6), math.floor(ends[1] + 1e-6)
        return min(max(first, low), high), max(min(last, high), low)

    def _exact(self, angle_rad: float) -> float:
        return CENTRE + (self.sign * angle_rad + self.neutral_rad) / COUNT_RAD
