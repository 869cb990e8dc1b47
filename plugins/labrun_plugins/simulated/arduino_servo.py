"""Stand-in for RC servos on an Arduino."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt

from labrun.devices import DeviceContext, DeviceError, DeviceSettings, Port, Trajectory
from labrun_plugins.simulated.joints import SimulatedJoints, joints_or_own_name
from labrun_plugins.simulated.settings import SimulatedSettings
from labrun_plugins.simulated.shaft import Shaft

_US_PER_DEG = 10.0
_PULSE_US = (500.0, 2500.0)
_NEUTRAL_US = 1500.0
_SHAFT = Shaft(
    frame_s=0.02,
    step_rad=float(np.radians(1.0 / _US_PER_DEG)),
    dead_band_rad=float(np.radians(2.0 / _US_PER_DEG)),
    speed_rad_s=float(np.radians(600.0)),
    natural_hz=6.0,
    damping=0.8,
)


class Joint(BaseModel):
    """One servo: Arduino pin, sense of rotation, and the servo angle at which the joint stands at zero."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    pin: NonNegativeInt | None = None
    sign: Literal[-1, 1] = 1
    neutral_deg: float = Field(default=0.0, ge=-90.0, le=90.0)


class ArduinoServoSettings(SimulatedSettings):
    """Keys of the Arduino servo: `joints` may be left out when there is one servo."""

    port: Port
    joints: dict[str, Joint] | None = Field(default=None, min_length=1)


class SimulatedArduinoServo(SimulatedJoints):
    """RC servos: a pulse every 20 ms in steps of 1 us (0.1 deg), 500 to 2500 us, no feedback.

    Frame, pulse step and missing feedback are those of the Arduino servo library. Chosen: 10 us/deg, dead
    band 2 us, 600 deg/s (above the 528 deg/s that the source work's best caudal gait asks for), and a closed
    loop of 6 Hz with damping ratio 0.8, as of a waterproof RC servo with a fin in water on its horn.
    """

    Settings: ClassVar[type[DeviceSettings]] = ArduinoServoSettings
    model = "RC servo on Arduino (simulated)"

    def __init__(self, name: str, settings: ArduinoServoSettings, context: DeviceContext) -> None:
        tables = settings.joints or dict.fromkeys(joints_or_own_name(name, context), Joint())
        super().__init__(
            name, settings, context, {joint: int(table.sign) for joint, table in tables.items()}, _SHAFT
        )
        self._neutral_deg = {joint: table.neutral_deg for joint, table in tables.items()}

    def _check(self, trajectory: Trajectory) -> None:
        super()._check(trajectory)
        for joint in self.joints:
            servo_deg = self._signs[joint] * np.degrees(trajectory.only((joint,)).angle_rad)
            pulse_us = _NEUTRAL_US + _US_PER_DEG * (servo_deg + self._neutral_deg[joint])
            if pulse_us.min() < _PULSE_US[0] or pulse_us.max() > _PULSE_US[1]:
                raise DeviceError(
                    self.name,
                    f"pulses of {pulse_us.min():.0f} to {pulse_us.max():.0f} us for {joint} leave "
                    f"{_PULSE_US[0]:.0f} to {_PULSE_US[1]:.0f} us; nothing was sent",
                    hint="set limits.angle_deg, so that the plan is refused before anything moves",
                )
