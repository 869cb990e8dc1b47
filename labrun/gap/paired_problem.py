"""One model for the data of two units, with a difference of each variable in the second one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, Scale
from labrun.fit import Jacobian, Problem

UNIT = "unit compared"
"""Key of a trial's condition that says which unit it is of."""
FIRST, SECOND, BOTH = "first", "second", ""

_HELD, _RELEASED = 1e-6, 1e4
"""Standard deviation of a difference that is held at zero, and of one that is not, in units of the variable."""


@dataclass(frozen=True, eq=False)
class PairedProblem(Problem):
    """A problem of two units: each variable has a difference in the second one; some effects act in one of them only.

    Attributes
    ----------
    indices, slots
        Of each variable that has a difference, its index among the parameters, and the index of its difference.
    ends
        The values it may take in the second unit.
    only
        Of every effect, the unit that has it; "" where both do.
    """

    indices: tuple[int, ...] = ()
    slots: tuple[int, ...] = ()
    ends: tuple[tuple[float, float], ...] = ()
    only: tuple[str, ...] = ()

    def with_differences(self, variables: Sequence[int]) -> Self:
        """Return the problem with a difference of each of these variables, held at zero."""
        priors, count = self.priors, len(self.priors.values)
        indices = [int(priors.free[variable]) for variable in variables]
        parameters = self.model.parameters
        ends = [
            (parameters[index].lower, parameters[index].upper)
            if index < len(parameters)
            else (float(end[0]), float(end[1]))
            for index, end in zip(indices, np.column_stack(self._ends(variables)), strict=True)
        ]
        slots = range(count, count + len(variables))
        scale = priors.scale[list(variables)]
        names = tuple(difference_of(priors.names[variable]) for variable in variables)
        held = replace(
            priors,
            values=np.append(priors.values, np.zeros(len(slots))),
            free=np.append(priors.free, slots),
            names=(*priors.names, *names),
            scale=np.append(priors.scale, scale),
            sigma=np.append(priors.sigma, _HELD * scale),
            pull=np.append(priors.pull, _HELD * scale),
            lower=np.append(priors.lower, np.full(len(slots), -np.inf)),
            upper=np.append(priors.upper, np.full(len(slots), np.inf)),
        )
        return replace(
            self,
            priors=held,
            indices=(*self.indices, *indices),
            slots=(*self.slots, *slots),
            ends=(*self.ends, *ends),
        )

    def _ends(self, variables: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        chosen = list(variables)
        scale = self.priors.scale[chosen]
        return self.priors.lower[chosen] * scale, self.priors.upper[chosen] * scale

    def differing(self, name: str) -> Self:
        """Return the problem in which a variable may differ."""
        variable = self.priors.names.index(difference_of(name))
        sigma, pull = self.priors.sigma.copy(), self.priors.pull.copy()
        sigma[variable], pull[variable] = np.inf, _RELEASED * self.priors.scale[variable]
        return replace(self, priors=replace(self.priors, sigma=sigma, pull=pull))

    def with_effect_in(self, unit: str, attached: AttachedEffect, scale: Scale) -> Self:
        """Return the problem with an effect that one unit has, or both."""
        return replace(self.with_effects([attached], [scale]), only=(*self.only, unit))

    def attached(self, parameters: FloatArray) -> tuple[AttachedEffect, ...]:
        """Return the effects with their sizes, as they are in the first unit."""
        return super().attached(np.delete(parameters, self.slots) if self.slots else parameters)

    def simulate(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        """Return the outputs (n, m) of one trial of its unit; None where they are not finite."""
        unit, parameters = self.data.trials[trial].condition[UNIT], parameters.copy()
        if unit == SECOND:
            for index, slot, (low, high) in zip(self.indices, self.slots, self.ends, strict=True):
                parameters[index] = min(max(parameters[index] + parameters[slot], low), high)
        for index, unit_of_effect, neutral in self._in_one_unit:
            if unit_of_effect not in (BOTH, unit) and neutral is not None:
                parameters[index] = neutral
        return super().simulate(parameters, trial, own)

    @cached_property
    def _in_one_unit(self) -> list[tuple[int, str, float | None]]:
        """Index among the parameters, unit, and neutral value of each parameter of the effects in one unit alone."""
        indices = iter(
            np.delete(np.arange(len(self.priors.values)), self.slots)[len(self.model.parameters) :]
        )
        return [
            (int(next(indices)), unit, parameter.neutral)
            for effect, unit in zip(self.effects, self.only, strict=True)
            for parameter in effect.effect.parameters
        ]

    def jacobian(
        self,
        z: FloatArray,
        residual: list[FloatArray] | None = None,
        *,
        central: bool = True,
        moving: NDArray[np.bool_] | None = None,
        given_jacobian: Jacobian | None = None,
    ) -> Jacobian:
        """Return residuals and their derivatives; those by a difference are those by its variable, in one unit."""
        free = self.priors.free.tolist()
        of, differences = ([free.index(index) for index in indices] for indices in (self.indices, self.slots))
        simulated = np.ones(self.size, dtype=bool) if moving is None else moving.copy()
        simulated[differences] = False
        jacobian = super().jacobian(
            z, residual, central=central, moving=simulated, given_jacobian=given_jacobian
        )
        if given_jacobian is None:
            for trial, shared in zip(self.data.trials, jacobian.shared, strict=True):
                if trial.condition[UNIT] == SECOND:
                    shared[:, differences] = shared[:, of]
        return jacobian


def difference_of(name: str) -> str:
    """Return the name of the difference of a variable."""
    return f"difference of {name}"
