"""The loop as it runs on a bench: a held drive, the plant, the mean over a cycle, samples, computation."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labrun.fit.transfer import TransferFunction
from labrun.fit.tuning.sampled import SampledPlant, sample_plant

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_SLOW, _FAST = 1e-3, 300.0
"""Frequencies looked at, over the slowest and the fastest time of the loop."""
_TURN_RAD = 0.05
"""Most that the dead time may turn the response from one frequency to the next."""
_TURNING = 100.0
"""Up to this frequency times the delay; beyond it a loop's gain is small or the same all the way round."""
_PER_DECADE = 200


@dataclass(frozen=True)
class Loop:
    """Everything of a loop but its controller.

    Attributes
    ----------
    plant
        What the drive does to the output.
    rate_hz
        Of the controller; None is one that acts continuously, for comparison with textbooks.
    compute_s
        From the newest sample to the drive it leads to.
    average_s
        The feedback is the output's mean over so long, a gait cycle; 0 is the output itself.
    """

    plant: TransferFunction
    rate_hz: float | None = None
    compute_s: float = 0.0
    average_s: float = 0.0

    @property
    def step_s(self) -> float:
        """Time from sample to sample; 0 if it is continuous."""
        return 0.0 if self.rate_hz is None else 1.0 / self.rate_hz

    @property
    def gain(self) -> float:
        """Static gain of the plant."""
        return float(self.plant.gain)

    @property
    def delay_s(self) -> float:
        """Dead time and what acts like one: computation, half a sample of holding, half an average."""
        return float(self.plant.dead_s) + self.compute_s + 0.5 * (self.step_s + self.average_s)

    @property
    def lags_s(self) -> FloatArray:
        """Time constants of the plant's poles, largest first."""
        sizes = np.abs(np.atleast_1d(np.asarray(self.plant.poles)))
        return np.sort(1.0 / sizes[sizes > 0])[::-1]

    def with_plant(self, plant: TransferFunction) -> "Loop":
        """Return the same loop around another plant."""
        return replace(self, plant=plant)

    @cached_property
    def sampled(self) -> SampledPlant:
        """From drive to feedback, sample by sample."""
        return sample_plant(self.plant, self.step_s, extra_s=self.compute_s, average_s=self.average_s)

    def frequency_response(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return feedback over drive, shape of `omega_rad_s` (positive, below the Nyquist frequency).

        Of a sampled loop it is that of the samples, with every alias: the response on the unit circle.
        """
        if self.rate_hz is not None:
            return self.sampled.frequency_response(np.exp(1j * omega_rad_s * self.step_s))
        response = np.asarray(self.plant.frequency_response(omega_rad_s), dtype=complex)
        s = 1j * omega_rad_s
        response = response * np.exp(-s * self.compute_s)
        if self.average_s > 0:
            response = response * (-np.expm1(-s * self.average_s) / (s * self.average_s))
        return np.asarray(response, dtype=complex)

    @cached_property
    def grid_rad_s(self) -> FloatArray:
        """Frequencies on which margins are sought, shape (n,): dense where dead time turns the phase."""
        times = [value for value in (*self.lags_s, self.delay_s) if value > 0] or [1.0]
        low = _SLOW / max(times)
        high = _FAST / min(times) if self.rate_hz is None else np.pi * self.rate_hz
        low = min(low, 0.01 * high)
        decades = float(np.log10(high / low))
        even = np.logspace(np.log10(low), np.log10(high), int(_PER_DECADE * decades) + 2)
        late_s = 2.0 * self.delay_s
        fine_to = min(high, _TURNING / late_s) if late_s > 0 else low
        fine = np.linspace(low, fine_to, max(int(fine_to * late_s / _TURN_RAD), 2))
        grid = np.unique(np.concatenate([even, fine]))
        # the Nyquist frequency itself is the last point: a fast loop may become unstable just there
        return np.asarray(grid[grid <= high])

    @cached_property
    def grid_response(self) -> ComplexArray:
        """Feedback over drive on `grid_rad_s`."""
        return self.frequency_response(self.grid_rad_s)
