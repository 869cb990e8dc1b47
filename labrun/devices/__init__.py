"""What a device is. A plugin needs this package and nothing deeper."""

from labrun.devices.clock import Clock
from labrun.devices.limits import Excess, Limits
from labrun.devices.plugin import DeviceContext, DevicePlugin, DeviceSettings, EmergencyStop, Port
from labrun.devices.protocols import Actuator, Carriage, Device, Health, Identity, Sensor, Tracker
from labrun.devices.samples import Channel, FloatArray, Samples
from labrun.devices.scene import Scene
from labrun.devices.trajectory import Trajectory
from labrun.errors import DeviceError

__all__ = [
    "Actuator",
    "Carriage",
    "Channel",
    "Clock",
    "Device",
    "DeviceContext",
    "DeviceError",
    "DevicePlugin",
    "DeviceSettings",
    "EmergencyStop",
    "Excess",
    "FloatArray",
    "Health",
    "Identity",
    "Limits",
    "Port",
    "Samples",
    "Scene",
    "Sensor",
    "Tracker",
    "Trajectory",
]
