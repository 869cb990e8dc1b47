"""The variables of a fit, and what is believed of them beforehand."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, Scale
from labrun.models import Model, Parameter

_UNBELIEVED = 1e4
"""Standard deviation of a free variable for the search, in units of its scale."""


@dataclass(frozen=True, eq=False)
class Priors:
    """Parameters of a model and of effects in it; which of them are fitted, in which scale, and held by what.

    Attributes
    ----------
    values : (k,)
        All of them, SI: the model's parameters in its order, then those of each effect.
    free : (p,), integers
        Places of the fitted ones among them: the variables. All arrays below are theirs.
    scale : (p,)
        What a scaled variable is a multiple of.
    sigma : (p,)
        Standard deviation of the stated value; inf where nothing was stated.
    pull : (p,)
        The same for the search, finite: where the data say nothing, it must not wander off.
    lower, upper : (p,)
        Bounds of the scaled variables.
    weight
        Factor on the prior's residuals.
    """

    values: FloatArray
    free: NDArray[np.intp]
    names: tuple[str, ...]
    scale: FloatArray
    sigma: FloatArray
    pull: FloatArray
    lower: FloatArray
    upper: FloatArray
    weight: float = 1.0

    @classmethod
    def of(cls, model: Model, *, weight: float = 1.0) -> Self:
        """Take a model's parameters as stated; those of tolerance 0 are no variables."""
        values = np.array([parameter.value for parameter in model.parameters], dtype=float)
        free = [index for index, parameter in enumerate(model.parameters) if parameter.tolerance != 0]
        parameters = [model.parameters[index] for index in free]
        scale = np.array([abs(one.value) if one.value != 0 else 1.0 for one in parameters], dtype=float)
        sigma = np.array([_stated_sigma(one) for one in parameters], dtype=float)
        return cls(
            values,
            np.array(free, dtype=np.intp),
            tuple(one.name for one in parameters),
            scale,
            sigma,
            np.where(np.isfinite(sigma), sigma, _UNBELIEVED * scale),
            np.array([one.lower for one in parameters], dtype=float) / scale,
            np.array([one.upper for one in parameters], dtype=float) / scale,
            weight,
        )

    @property
    def size(self) -> int:
        """Number of variables."""
        return len(self.free)

    @property
    def stated(self) -> FloatArray:
        """The scaled variables as stated, (p,)."""
        return np.asarray(self.values[self.free] / self.scale)

    @property
    def slope(self) -> FloatArray:
        """Derivative of each variable's prior residual by the variable, (p,)."""
        return np.asarray(-self.weight * self.scale / self.pull)

    def parameters(self, z: FloatArray) -> FloatArray:
        """Return all values, those of the variables taken from the front of `z`."""
        values = self.values.copy()
        values[self.free] = z[: self.size] * self.scale
        return values

    def residual(self, z: FloatArray) -> FloatArray:
        """Return (stated value - value) / sigma of the variables; next to nothing where none was stated."""
        away = (self.values[self.free] - z[: self.size] * self.scale) / self.pull
        return np.asarray(self.weight * away)

    def with_effects(self, effects: Sequence[AttachedEffect], scales: Sequence[Scale], first: int) -> Self:
        """Return priors with the parameters of further effects, of which all that are not held are variables.

        `scales`: what is typical at the site of each. `first`: number of the first of them among all effects, which
        names their variables: "0.torque".
        """
        added = [
            (parameter, value, number, typical.of(parameter.quantity))
            for number, (attached, typical) in enumerate(zip(effects, scales, strict=True), start=first)
            for parameter, value in zip(attached.effect.parameters, attached.values, strict=True)
        ]
        free = [place for place, (one, *_) in enumerate(added, start=len(self.values)) if not one.held]
        fitted = [one for one in added if not one[0].held]
        scale = np.array([size for *_, size in fitted])
        return replace(
            self,
            values=np.concatenate([self.values, [value for _, value, _, _ in added]]),
            free=np.concatenate([self.free, np.array(free, dtype=np.intp)]),
            names=(*self.names, *(f"{number}.{one.name}" for one, _, number, _ in fitted)),
            scale=np.concatenate([self.scale, scale]),
            sigma=np.concatenate([self.sigma, np.full(len(fitted), np.inf)]),
            pull=np.concatenate([self.pull, _UNBELIEVED * scale]),
            lower=np.concatenate([self.lower, [one.lower for one, *_ in fitted]]),
            upper=np.concatenate([self.upper, [one.upper for one, *_ in fitted]]),
        )

    def within(self, tolerances: float) -> Self:
        """Return priors that let a variable move by at most so many of its stated standard deviations."""
        room = tolerances * (self.sigma / self.scale)
        believed = np.isfinite(room)
        return replace(
            self,
            lower=np.where(believed, np.maximum(self.lower, self.stated - room), self.lower),
            upper=np.where(believed, np.minimum(self.upper, self.stated + room), self.upper),
        )

    def releasing(self, parameter: Parameter, factor: float) -> Self:
        """Return priors that believe a parameter's statement only to a factor, either way."""
        variable = self.names.index(parameter.name)
        scale = self.scale[variable]
        stated = parameter.value / scale
        low, high = sorted((stated / factor, stated * factor)) if stated else (-np.inf, np.inf)

        return replace(
            self,
            sigma=changed(self.sigma, variable, np.inf),
            pull=changed(self.pull, variable, _UNBELIEVED * scale),
            lower=changed(self.lower, variable, max(parameter.lower / scale, low)),
            upper=changed(self.upper, variable, min(parameter.upper / scale, high)),
        )


def changed(values: FloatArray, place: int | list[int], value: float | FloatArray) -> FloatArray:
    """Return values with others at one place, or at some."""
    values = values.copy()
    values[place] = value
    return values


def _stated_sigma(parameter: Parameter) -> float:
    """Return the standard deviation that a tolerance stands for; relative to one for a parameter of value zero."""
    if isinstance(parameter.tolerance, str):
        return float("inf")
    return parameter.tolerance * (abs(parameter.value) if parameter.value != 0 else 1.0)
