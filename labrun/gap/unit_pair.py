"""Two units in one problem: what they share, and what differs in the second."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, Scale
from labrun.fit import Dataset, FitTrial, Problem

UNIT = "unit compared"
"""Key of a trial's condition that says which unit it is of."""
FIRST, SECOND, BOTH = "first", "second", ""


def both_units(first: Dataset, second: Dataset) -> Dataset:
    """Return the trials of both, each with its unit in its condition."""

    def of(data: Dataset, unit: str) -> list[FitTrial]:
        return [replace(one, condition={**one.condition, UNIT: unit}) for one in data.trials]

    return replace(first, trials=(*of(first, FIRST), *of(second, SECOND)))


@dataclass(frozen=True, eq=False)
class UnitPair(Problem):
    """A problem of two units: some parameters differ in the second one, some effects act in one of them only.

    Attributes
    ----------
    places, slots
        Of what differs, its place among the parameters, and where its difference stands among them.
    ends
        The values it may take.
    only
        Of every effect, the unit that has it; "" where both do.
    """

    places: tuple[int, ...] = ()
    slots: tuple[int, ...] = ()
    ends: tuple[tuple[float, float], ...] = ()
    only: tuple[str, ...] = ()

    def differing(self, variable: int) -> Self:
        """Return the problem in which one more of the variables may differ in the second unit."""
        priors = self.priors
        place, scale = int(priors.free[variable]), priors.scale[variable]
        low, high = priors.lower[variable] * scale, priors.upper[variable] * scale
        if place < len(self.model.parameters):
            low, high = self.model.parameters[place].lower, self.model.parameters[place].upper
        released = replace(
            priors,
            values=np.append(priors.values, 0.0),
            free=np.append(priors.free, len(priors.values)),
            names=(*priors.names, f"difference of {priors.names[variable]}"),
            scale=np.append(priors.scale, scale),
            sigma=np.append(priors.sigma, np.inf),
            pull=np.append(priors.pull, 1e4 * scale),
            lower=np.append(priors.lower, -np.inf),
            upper=np.append(priors.upper, np.inf),
        )
        return replace(
            self,
            priors=released,
            places=(*self.places, place),
            slots=(*self.slots, len(priors.values)),
            ends=(*self.ends, (float(low), float(high))),
        )

    def with_effect_in(self, unit: str, attached: AttachedEffect, scale: Scale) -> Self:
        """Return the problem with an effect that one unit has."""
        return replace(self.with_effects([attached], [scale]), only=(*self.only, unit))

    def attached(self, parameters: FloatArray) -> tuple[AttachedEffect, ...]:
        """Return the effects with their sizes, as they are in the first unit."""
        return super().attached(np.delete(parameters, self.slots) if self.slots else parameters)

    def simulate(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        """Return the outputs (n, m) of one trial of its unit; None where they are not finite."""
        unit, parameters = self.data.trials[trial].condition[UNIT], parameters.copy()
        if unit == SECOND:
            for place, slot, (low, high) in zip(self.places, self.slots, self.ends, strict=True):
                parameters[place] = min(max(parameters[place] + parameters[slot], low), high)
        free = np.setdiff1d(np.arange(len(parameters)), self.slots)[len(self.model.parameters) :]
        at = 0
        for number, one in enumerate(self.effects):
            has = self.only[number] if number < len(self.only) else ""
            for parameter in one.effect.parameters:
                if has not in ("", unit) and parameter.neutral is not None:
                    parameters[free[at]] = parameter.neutral
                at += 1
        return super().simulate(parameters, trial, own)
