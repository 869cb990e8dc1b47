"""How a device plugin is made."""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from labrun.devices.clock import Clock
from labrun.devices.limits import Limits
from labrun.devices.protocols import Device
from labrun.devices.scene import Scene


class DeviceSettings(BaseModel):
    """What every device of an experiment file may say; a plugin's own settings extend it.

    A field of type `Port` is checked to exist before a run on hardware.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    example: ClassVar[str] = ""
    """Keys to start from, in TOML with comments: what `labrun new` writes for the device."""

    limits: Limits = Limits()


Port = Annotated[str, "port"]
"""A serial port or network address."""


@dataclass(frozen=True, slots=True)
class DeviceContext:
    """What a device gets from the run it is part of.

    Attributes
    ----------
    clock
        All waiting and all time stamps go through it.
    rng
        The device's own generator, derived from the run's seed; re-seeded per trial by the runner through
        `reseed` where a device has that method, so that a resumed run repeats itself exactly.
    scene
        The simulated bench; None on hardware.
    """

    clock: Clock
    rng: np.random.Generator
    scene: Scene | None = None


class DevicePlugin(Protocol):
    """The class an entry point of group ``labrun.devices`` names.

    `stand_in` is the plugin that takes its place in a dry run; without it, ``simulated-<name>`` is looked for.
    """

    Settings: ClassVar[type[DeviceSettings]]

    def __call__(self, name: str, settings: Any, context: DeviceContext) -> Device:
        """Make the device; connects nothing."""
        ...


class EmergencyStop(Protocol):
    """What an actuator's plugin class offers to the watchdog, which runs in another process."""

    def emergency_stop(self, name: str, settings: Any) -> None:
        """Connect from scratch and stop all motion (a class method): the runner is dead or hangs."""
        ...


__all__ = ["DeviceContext", "DevicePlugin", "DeviceSettings", "EmergencyStop", "Field", "Port"]
