"""What the simulated force/torque sensors share: six axes with noise, offset, drift and resolution."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.devices import SIX_AXES, DeviceContext, FloatArray
from labrun.models import kernel
from labrun_plugins.simulated.device import SimulatedSettings
from labrun_plugins.simulated.sensor import SimulatedSensor, Timing

_NAMES = tuple(channel.name for channel in SIX_AXES)
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
            channels=SIX_AXES, rate_hz=rate_hz, timing=timing, full_scale=np.array(axes.full_scale),
            counts_frames=counts_frames, has_clock=has_clock,
        )  # fmt: skip
        offset = context.rng.standard_normal(6) * axes.offset_sd
        drift = context.rng.standard_normal(6) * axes.offset_sd * axes.drift_share
        self._constants = np.array([axes.noise_sd, offset, drift, axes.resolution])
        signals = () if context.scene is None else context.scene.signals
        self._felt_names = tuple(axis for axis in _NAMES if axis in signals)
        self._felt = np.array([_NAMES.index(axis) for axis in self._felt_names], dtype=np.int64)

    def _measure(self, time_s: FloatArray) -> FloatArray:
        noise = self._rng.standard_normal((len(time_s), 6))
        felt = (
            self.scene.observe(self._felt_names, time_s) if self._felt_names else np.empty((len(time_s), 0))
        )
        _read(noise, felt, time_s, self._felt, self._constants)
        return noise


@kernel
def _read(
    values: FloatArray, felt: FloatArray, time_s: FloatArray, axes: NDArray[np.int64], constants: FloatArray
) -> None:
    """Turn standard noise into readings: noise, offset and drift added to what is felt, in whole steps.

    `constants` holds noise, offset, amplitude of the drift, and resolution of each axis, shape (4, 6).
    """
    for i in range(len(values)):
        drift = math.sin(2.0 * math.pi / _DRIFT_PERIOD_S * time_s[i])
        for k in range(values.shape[1]):
            values[i, k] = values[i, k] * constants[0, k] + constants[1, k] + drift * constants[2, k]
        for j in range(len(axes)):
            values[i, axes[j]] += felt[i, j]
        for k in range(values.shape[1]):
            values[i, k] = np.round(values[i, k] / constants[3, k]) * constants[3, k]
