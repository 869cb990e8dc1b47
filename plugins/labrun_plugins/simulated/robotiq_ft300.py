"""Stand-in for the Robotiq FT300 force/torque sensor."""

from typing import ClassVar

from labrun.devices import DeviceContext, DeviceSettings
from labrun_plugins.robotiq_ft300.settings import RobotiqFt300Settings
from labrun_plugins.simulated.device import SimulatedSettings
from labrun_plugins.simulated.force_torque import SimulatedForceTorque, SixAxes
from labrun_plugins.simulated.sensor import Timing

_AXES = SixAxes(
    full_scale=(300.0, 300.0, 300.0, 30.0, 30.0, 30.0),
    resolution=(0.01, 0.01, 0.01, 0.001, 0.001, 0.001),
    noise_sd=(0.1, 0.1, 0.1, 0.005, 0.005, 0.003),
    offset_sd=(3.0, 3.0, 3.0, 0.1, 0.1, 0.1),
    drift_share=0.01,
)
_TIMING = Timing(latency_s=0.0083, jitter_s=0.0007, lost_share=2e-4)
_STREAM_HZ = 100.0


class SimulatedRobotiqFt300Settings(RobotiqFt300Settings, SimulatedSettings):
    """Keys of the FT300, and of every simulated device."""


class SimulatedRobotiqFt300(SimulatedForceTorque):
    """100 samples/s (`poll_hz` with ``stream = false``), +-300 N and +-30 N m in steps of 0.01 N and 0.001 N m.

    The stream has neither counter nor time stamp: a lost frame shows only as a gap, and the device time
    repeats the host time. A frame takes 8.3 ms on the wire (16 bytes at 19 200 baud), which is the latency.
    Rates, ranges and steps are those of the sensor's manual; noise (0.1 N, 0.003 N m), offset and drift are
    chosen to be of the size users report, because the manual's figure is the step alone.
    """

    Settings: ClassVar[type[DeviceSettings]] = SimulatedRobotiqFt300Settings
    model = "Robotiq FT300 (simulated)"

    def __init__(self, name: str, settings: SimulatedRobotiqFt300Settings, context: DeviceContext) -> None:
        rate_hz = _STREAM_HZ if settings.stream else settings.poll_hz
        super().__init__(
            name, settings, context,
            axes=_AXES, rate_hz=rate_hz, timing=_TIMING, counts_frames=False, has_clock=False,
        )  # fmt: skip
