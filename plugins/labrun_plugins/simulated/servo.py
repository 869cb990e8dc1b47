"""A plain simulated servo, for experiments that name no real one yet."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from labrun.devices import DeviceContext, DeviceSettings
from labrun_plugins.simulated.joints import SimulatedJoints, joints_or_own_name
from labrun_plugins.simulated.settings import SimulatedSettings
from labrun_plugins.simulated.shaft import Shaft

_SHAFT = Shaft(
    frame_s=0.005, step_rad=1e-6, dead_band_rad=0.0, speed_rad_s=float(np.radians(720.0)),
    natural_hz=25.0, damping=0.8,
)  # fmt: skip


class Joint(BaseModel):
    """One joint: a servo with sign -1 is mounted the other way round."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sign: Literal[-1, 1] = 1


class ServoSettings(SimulatedSettings):
    """`joints`: joint -> table; without it, the joint called like the device, or the bench's only one."""

    joints: dict[str, Joint] | None = Field(default=None, min_length=1)


class SimulatedServo(SimulatedJoints):
    """A servo better than real ones (chosen): 200 commands/s, 25 Hz, 720 deg/s, no dead band."""

    Settings: ClassVar[type[DeviceSettings]] = ServoSettings
    model = "servo (simulated)"

    def __init__(self, name: str, settings: ServoSettings, context: DeviceContext) -> None:
        if settings.joints is None:
            signs = dict.fromkeys(joints_or_own_name(name, context), 1)
        else:
            signs = {joint: int(table.sign) for joint, table in settings.joints.items()}
        super().__init__(name, settings, context, signs, _SHAFT)
