"""What the simulated force/torque sensors share: six axes with noise, offset, drift and resolution."""

from dataclasses import dataclass

import numpy as np

from labrun.devices import Channel, DeviceContext, FloatArray
from labrun_plugins.simulated.sensor import SimulatedSensor
from labrun_plugins.simulated.settings import SimulatedSettings
from labrun_plugins.simulated.stream import Timing

CHANNELS = (
    Channel("force_x", "N"), Channel("force_y", "N"), Channel("force_z", "N"),
    Channel("torque_x", "N m"), Channel("torque_y", "N m"), Channel("torque_z", "N m"),
)  # fmt: skip
_NAMES = tuple(channel.name for channel in CHANNELS)
_DRIFT_PERIOD_S = 3600.0


@dataclass(frozen=True, slots=True)
class SixAxes:
    """How good a six-axis sensor is; each tuple is force x, y, z (N), torque x, y, z (N m)."""

    full_scale: tuple[float, ...]
    resolution: tuple[float, ...]
    noise_sd: tuple[float, ...]
    offset_sd: tuple[float, ...]
    """Spread of the offset it wakes up with: why a tare is needed."""
    drift_share: float
    """Amplitude of its slow drift, as a share of the offset's spread."""


class SimulatedForceTorque(SimulatedSensor):
    """A six-axis force/torque sensor; an axis the scene does not feel reads noise around its offset."""

    def __init__(
        self,
        name: str,
        settings: SimulatedSettings,
        context: DeviceContext,
        *,
        axes: SixAxes,
        rate_hz: float,
        timing: Timing,
        counts_frames: bool,
        has_clock: bool,
    ) -> None:
        super().__init__(
            name, settings, context,
            channels=CHANNELS, rate_hz=rate_hz, timing=timing, full_scale=np.array(axes.full_scale),
            counts_frames=counts_frames, has_clock=has_clock,
        )  # fmt: skip
        self._resolution = np.array(axes.resolution)
        self._noise_sd = np.array(axes.noise_sd)
        self._offset = context.rng.standard_normal(6) * axes.offset_sd
        self._drift = context.rng.standard_normal(6) * axes.offset_sd * axes.drift_share
        signals = () if context.scene is None else context.scene.signals
        self._felt = [index for index, axis in enumerate(_NAMES) if axis in signals]
        self._felt_names = [_NAMES[index] for index in self._felt]

    def _measure(self, time_s: FloatArray) -> FloatArray:
        values = self._rng.standard_normal((len(time_s), 6))
        values *= self._noise_sd
        values += self._offset
        values += np.sin(2 * np.pi / _DRIFT_PERIOD_S * time_s)[:, None] * self._drift
        if self._felt:
            values[:, self._felt] += self.scene.observe(self._felt_names, time_s)
        values /= self._resolution
        np.round(values, out=values)
        values *= self._resolution
        return values
