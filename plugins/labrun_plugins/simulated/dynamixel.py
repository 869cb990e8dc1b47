"""Stand-in for Dynamixel XM430 servos."""

from collections.abc import Mapping
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveInt, model_validator

from labrun.devices import DeviceContext, DeviceError, DeviceSettings, Health, Port, Trajectory
from labrun_plugins.simulated.joints import SimulatedJoints
from labrun_plugins.simulated.settings import SimulatedSettings
from labrun_plugins.simulated.shaft import Shaft

_COUNT_RAD = 2 * np.pi / 4096
_SPEED_RAD_S = 330 * 0.229 * 2 * np.pi / 60
_SHAFT = Shaft(
    frame_s=0.005, step_rad=_COUNT_RAD, dead_band_rad=0.0, speed_rad_s=_SPEED_RAD_S,
    natural_hz=15.0, damping=0.8,
)  # fmt: skip


class Joint(BaseModel):
    """One servo: its id on the bus, and its sense of rotation."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: int = Field(ge=0, le=252)
    sign: Literal[-1, 1] = 1


class DynamixelSettings(SimulatedSettings):
    """Keys of the Dynamixel bus: serial `port`, `baud`, and joint -> servo."""

    port: Port
    baud: PositiveInt = 1_000_000
    joints: dict[str, Joint] = Field(min_length=1)

    @model_validator(mode="after")
    def _ids_differ(self) -> "DynamixelSettings":
        owners: dict[int, str] = {}
        for joint, table in self.joints.items():
            other = owners.setdefault(table.id, joint)
            if other != joint:
                raise ValueError(f"joints {other} and {joint} both have id {table.id}")
        return self


class SimulatedDynamixel(SimulatedJoints):
    """XM430-W210 in position mode: 4096 counts a turn both ways, 330 x 0.229 rev/min at most.

    Counts and velocity limit are those of the control table. Chosen: 200 group writes per second, a closed loop of
    15 Hz with damping ratio 0.8.
    """

    Settings: ClassVar[type[DeviceSettings]] = DynamixelSettings
    model = "Dynamixel XM430-W210 (simulated)"

    def __init__(self, name: str, settings: DynamixelSettings, context: DeviceContext) -> None:
        signs = {joint: int(table.sign) for joint, table in settings.joints.items()}
        super().__init__(name, settings, context, signs, _SHAFT)

    def pose(self) -> Mapping[str, float]:
        """Return the measured angles, rad, in whole counts."""
        self._require_answer()
        now = self._clock.now()
        return {
            joint: round(self._angle(self._motion, joint, now) / _COUNT_RAD) * _COUNT_RAD
            for joint in self.joints
        }

    def health(self) -> Health:
        """Report the servos' temperature, which a simulated servo keeps at 35 degC."""
        state = super().health()
        return Health(ok=state.ok, temperature_c=35.0 if state.ok else None, notes=state.notes)

    def _check(self, trajectory: Trajectory) -> None:
        super()._check(trajectory)
        if np.abs(trajectory.angle_rad).max() > np.pi:
            raise DeviceError(
                self.name,
                "position mode covers one turn (+-180 deg); nothing was sent",
                hint="set limits.angle_deg, so that the plan is refused before anything moves",
            )
