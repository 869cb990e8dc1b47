"""Stand-in for an ATI Mini40 force/torque sensor on a Net F/T box."""

from typing import ClassVar

from labrun.devices import DeviceContext, DeviceSettings
from labrun_plugins.ati_netft.settings import BOX_RATE_HZ, RANGES, AtiNetFtSettings
from labrun_plugins.simulated.device import SimulatedSettings
from labrun_plugins.simulated.force_torque import SimulatedForceTorque, SixAxes
from labrun_plugins.simulated.sensor import Timing

_FORCE_STEPS = 4000.0
_TORQUE_STEPS = 8000.0
"""Steps from zero to full scale: 1/200 N and 1/8000 N m for SI-20-1, as in the sensor's catalogue."""


class SimulatedAtiNetFtSettings(AtiNetFtSettings, SimulatedSettings):
    """Keys of the Net F/T box, and what its stand-in may be told besides."""


class SimulatedAtiNetFt(SimulatedForceTorque):
    """Up to 7000 samples/s by UDP, with sequence numbers, so that lost datagrams are counted.

    The box keeps every n-th of its 7000 internal samples per second (it does not average), so the true rate
    is 7000/n. Ranges follow the calibration; noise is 1.5 steps (chosen: the catalogue states the step
    alone).
    """

    Settings: ClassVar[type[DeviceSettings]] = SimulatedAtiNetFtSettings
    model = "ATI Mini40, Net F/T (simulated)"

    def __init__(self, name: str, settings: SimulatedAtiNetFtSettings, context: DeviceContext) -> None:
        force, axial, torque = RANGES[settings.calibration]
        full_scale = (force, force, axial, torque, torque, torque)
        resolution = (
            force / _FORCE_STEPS, force / _FORCE_STEPS, 2 * force / _FORCE_STEPS,
            torque / _TORQUE_STEPS, torque / _TORQUE_STEPS, torque / _TORQUE_STEPS,
        )  # fmt: skip
        axes = SixAxes(
            full_scale=full_scale,
            resolution=resolution,
            noise_sd=tuple(1.5 * step for step in resolution),
            offset_sd=tuple(0.02 * end for end in full_scale),
            drift_share=0.02,
        )
        timing = Timing(
            latency_s=0.0003, jitter_s=0.0001, lost_share=1e-4,
            clock_offset_s=float(context.rng.uniform(10, 1000)), clock_drift=2e-5,
        )  # fmt: skip
        super().__init__(
            name, settings, context,
            axes=axes, rate_hz=BOX_RATE_HZ / max(1, round(BOX_RATE_HZ / settings.rate_hz)), timing=timing,
            counts_frames=True, has_clock=True,
        )  # fmt: skip
