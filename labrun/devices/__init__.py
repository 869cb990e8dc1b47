"""What a device is. A plugin needs this and nothing deeper; its emulator `emulation` and `emulated_ports`, too."""

from labrun.arrays import FloatArray
from labrun.devices.clock import Clock
from labrun.devices.limits import Excess, Limits
from labrun.devices.listening import Listener, ListeningSensor, SampleBuffer, listened
from labrun.devices.orientation import EulerAngles, HingeAngle, OrientationAngles, turn_about, unknown_bodies
from labrun.devices.pacing import CommandStream, Pacing
from labrun.devices.protocols import (
    Actuator,
    Arranging,
    Attended,
    Carriage,
    Device,
    DeviceContext,
    DevicePlugin,
    DeviceSettings,
    EmergencyStop,
    Health,
    Identity,
    Paced,
    Port,
    Remark,
    Scene,
    Sensor,
    Tracker,
    opened,
    streaming,
)
from labrun.devices.samples import SIX_AXES, Channel, Samples
from labrun.devices.serial_port import SerialPort
from labrun.devices.terminal import NoTerminalError, Terminal
from labrun.devices.trajectory import Trajectory
from labrun.errors import DeviceError

__all__ = [
    "SIX_AXES", "Actuator", "Arranging", "Attended", "Carriage", "Channel", "Clock", "CommandStream", "Device",
    "DeviceContext", "DeviceError", "DevicePlugin", "DeviceSettings", "EmergencyStop", "EulerAngles", "Excess",
    "FloatArray", "Health", "HingeAngle", "Identity", "Limits", "Listener", "ListeningSensor", "NoTerminalError",
    "OrientationAngles", "Paced", "Pacing", "Port", "Remark", "SampleBuffer", "Samples", "Scene", "Sensor",
    "SerialPort", "Terminal", "Tracker", "Trajectory", "listened", "opened", "streaming", "turn_about",
    "unknown_bodies",
]  # fmt: skip
