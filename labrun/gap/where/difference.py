"""What is compared: a recalibrated model beside the mean of every unit of data."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect
from labrun.fit.dataset import Dataset
from labrun.gap.noise import Noise
from labrun.models import Drive, Model

_FORM_SLACK = 5e-4
"""Part of a channel's spread below which no model is believed: integrators and sampling differ by as much."""
_LEAST_SPREAD = 1e-3
"""Of a signal that hardly varies, in units of its noise."""


@dataclass(frozen=True)
class Difference:
    """A model, and what the measurement says otherwise.

    Attributes
    ----------
    model
        With the way its inputs run between samples set as the recording says.
    units, noise
        The data, and how much of a single trial is noise.
    parameters : (parameters,)
        Recalibrated.
    effects
        Physics that is part of the model compared already; mostly none.
    initial : per unit (k,)
        State each unit begins in.
    drives : per unit
        Its inputs, as `labrun.models.prepare` lays them out.
    simulated : per unit (n, m)
    residual : per unit (n, m)
        Mean of the measured trials minus simulated, in the units of the outputs.
    jacobian : (sum of n*m, p)
        Derivative of the simulated outputs by what recalibration may change (free parameters and initial states),
        unit after unit, each (n, m) row by row. None where nothing was recalibrated.
    """

    model: Model
    units: Dataset
    noise: Noise
    parameters: FloatArray
    effects: tuple[AttachedEffect, ...]
    initial: tuple[FloatArray, ...]
    drives: tuple[Drive, ...]
    simulated: tuple[FloatArray, ...]
    residual: tuple[FloatArray, ...]
    jacobian: FloatArray | None = None

    @cached_property
    def noise_sd(self) -> FloatArray:
        """Standard deviation of one trial's noise, shape (m,), with what no model is believed to.

        Where nothing was repeated, noise is what the model leaves; channels of the same unit are then taken to have
        the same, or none could hold more of the gap than another.
        """
        sd = np.hypot(self.noise.sd, _FORM_SLACK * self.spread)
        return sd if self.noise.basis == "repeats" else self._over_units(sd)

    @cached_property
    def scale(self) -> FloatArray:
        """What residuals are measured in, shape (m,): the noise, where repeats tell it, else how much signals vary."""
        if self.noise.basis == "repeats":
            return self.noise_sd
        return np.maximum(self._over_units(self.spread), self.noise_sd * _LEAST_SPREAD)

    @property
    def output_units(self) -> list[str]:
        """Units of the outputs, as recorded."""
        return [one.unit for one in self.units.outputs]

    def _over_units(self, values: FloatArray) -> FloatArray:
        """Return the root mean square over all channels of the same unit."""
        units = self.output_units
        return np.array(
            [
                np.sqrt(np.mean([values[other] ** 2 for other, unit in enumerate(units) if unit == own]))
                for own in units
            ]
        )

    @cached_property
    def spread(self) -> FloatArray:
        """Standard deviation of each measured channel over all data, shape (m,)."""
        outputs = np.concatenate([unit.outputs for unit in self.units.trials])
        return np.asarray(np.std(outputs, axis=0), dtype=float)

    @cached_property
    def scaled(self) -> list[FloatArray]:
        """Residuals of every unit in units of `scale`."""
        return [one / self.scale for one in self.residual]
