"""Stand-in for the Robotiq FT300 force/torque sensor."""

from typing import ClassVar

from labrun.devices import DeviceContext, DeviceSettings, Port
from labrun_plugins.simulated.force_torque import SimulatedForceTorque, SixAxes
from labrun_plugins.simulated.settings import SimulatedSettings
from labrun_plugins.simulated.stream import Timing

_AXES = SixAxes(
    full_scale=(300.0, 300.0, 300.0, 30.0, 30.0, 30.0),
    resolution=(0.01, 0.01, 0.01, 0.001, 0.001, 0.001),
    noise_sd=(0.1, 0.1, 0.1, 0.005, 0.005, 0.003),
    offset_sd=(3.0, 3.0, 3.0, 0.1, 0.1, 0.1),
    drift_share=0.01,
)
_TIMING = Timing(latency_s=0.0083, jitter_s=0.0007, lost_share=2e-4)


class RobotiqFt300Settings(SimulatedSettings):
    """Keys of the FT300: `port` is its serial port."""

    port: Port


class SimulatedRobotiqFt300(SimulatedForceTorque):
    """100 samples/s, +-300 N and +-30 N m in steps of 0.01 N and 0.001 N m.

    The stream has neither counter nor time stamp: a lost frame shows only as a gap, and the device time
    repeats the host time. A frame takes 8.3 ms on the wire (16 bytes at 19 200 baud), which is the latency.
    Rates, ranges and steps are those of the sensor's manual; noise (0.1 N, 0.003 N m), offset and drift are
    chosen to be of the size users report, because the manual's figure is the step alone.
    """

    Settings: ClassVar[type[DeviceSettings]] = RobotiqFt300Settings
    model = "Robotiq FT300 (simulated)"

    def __init__(self, name: str, settings: RobotiqFt300Settings, context: DeviceContext) -> None:
        super().__init__(
            name, settings, context,
            axes=_AXES, rate_hz=100.0, timing=_TIMING, counts_frames=False, has_clock=False,
        )  # fmt: skip
