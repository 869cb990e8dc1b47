"""Stand-in for an ATI Mini40 force/torque sensor on a data acquisition card."""

from typing import ClassVar

from labrun.devices import DeviceContext, DeviceSettings
from labrun_plugins.ati_daq.settings import AtiDaqSettings
from labrun_plugins.ati_netft.settings import full_scale
from labrun_plugins.simulated.device import SimulatedSettings
from labrun_plugins.simulated.force_torque import SimulatedForceTorque, SixAxes
from labrun_plugins.simulated.sensor import Timing

_FULL_SCALE = full_scale("SI-20-1")
_STEPS = 15_000.0
"""From zero to full scale: a 16-bit card whose range the sensor uses to nearly the half."""


class SimulatedAtiDaqSettings(AtiDaqSettings, SimulatedSettings):
    """Keys of the sensor and its card, and what the stand-in may be told besides."""


class SimulatedAtiDaq(SimulatedForceTorque):
    """A Mini40 SI-20-1, whatever the calibration file says, sampled by the card's own clock; nothing is lost."""

    Settings: ClassVar[type[DeviceSettings]] = SimulatedAtiDaqSettings
    model = "ATI Mini40, analogue (simulated)"

    def __init__(self, name: str, settings: SimulatedAtiDaqSettings, context: DeviceContext) -> None:
        self.zero_known = any(settings.bias_v)
        resolution = tuple(end / _STEPS for end in _FULL_SCALE)
        axes = SixAxes(
            full_scale=_FULL_SCALE,
            resolution=resolution,
            noise_sd=tuple(4.0 * step for step in resolution),
            offset_sd=tuple(0.02 * end for end in _FULL_SCALE),
            drift_share=0.02,
        )
        timing = Timing(latency_s=0.002, jitter_s=0.001, clock_drift=3e-5)
        super().__init__(
            name, settings, context,
            axes=axes, rate_hz=settings.rate_hz, timing=timing, counts_frames=True, has_clock=True,
        )  # fmt: skip
