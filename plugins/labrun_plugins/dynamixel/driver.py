"""Dynamixel servos, with or without a stream of measurements."""

from labrun.devices import DeviceContext
from labrun_plugins.dynamixel.feedback import DynamixelWithFeedback
from labrun_plugins.dynamixel.servos import DynamixelServos
from labrun_plugins.dynamixel.settings import DynamixelSettings


class Dynamixel(DynamixelServos):
    """A bus of servos; with `feedback_hz` above zero it is a sensor as well, see `DynamixelWithFeedback`."""

    def __new__(cls, name: str, settings: DynamixelSettings, context: DeviceContext) -> DynamixelServos:  # type: ignore[misc]
        """Make the device, as a sensor too if the file asks for a stream of measurements."""
        if settings.feedback_hz > 0.0:
            return DynamixelWithFeedback(name, settings, context)
        return object.__new__(cls)
