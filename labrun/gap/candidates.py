"""The candidates: every effect of the library at every site it fits, and every parameter that could be wrong."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from labrun.effects import AttachedEffect, Effect, Scale
from labrun.errors import ModelError, RequestError
from labrun.fit.problem import Problem
from labrun.gap import criteria
from labrun.gap.diagnosis import Name
from labrun.models import Model
from labrun.toml import nearest


@dataclass(frozen=True)
class Candidate:
    """Something that may be missing in the model, and how to add it to a problem.

    Attributes
    ----------
    attached, scale
        Of an effect; None for a parameter.
    starts
        Sizes to start a fit from, in multiples of what is typical at the site, of the variables that are fitted.
    """

    name: Name
    attached: AttachedEffect | None
    scale: Scale | None
    starts: tuple[tuple[float, ...], ...]

    @property
    def variables(self) -> int:
        """Number of variables it adds to a fit."""
        if self.attached is None:
            return 0
        return sum(not parameter.held for parameter in self.attached.effect.parameters)

    def added_to(self, problem: Problem) -> Problem:
        """Return the problem with this candidate in it."""
        if self.attached is None or self.scale is None:
            parameter = next(one for one in problem.model.parameters if one.name == self.name.effect)
            return replace(problem, priors=problem.priors.releasing(parameter, criteria.FAR_OFF))
        return problem.with_effects([self.attached], [self.scale])


def candidates(
    model: Model, scales: dict[tuple[str, str], Scale], withhold: Collection[str] = ()
) -> list[Candidate]:
    """Return all candidates of a model.

    Parameters
    ----------
    scales : (kind, site) -> typical magnitudes there
    withhold
        Ids of effects that the library is to be without, and without those that contain them. A plugin of that name
        is not imported.

    Raises
    ------
    RequestError
        An effect to withhold that does not exist.
    """
    from labrun import registry
    from labrun.effects import effects

    library = effects(without=withhold)
    known = sorted({*registry.names("labrun.effects"), *(effect.id for effect in library)})
    for name in withhold:
        if name not in known:
            near = nearest(name, known)
            raise RequestError(
                f"there is no effect {name!r} to withhold",
                hint=f"did you mean {near!r}?" if near else f"effects: {', '.join(known)}",
            )
    found = []
    for effect in library:
        if effect.id in withhold or any(name in withhold for name in effect.contains):
            continue
        for site in model.places:
            if effect.kind == site.kind and (site.kind, site.name) in scales and effect.fits(site):
                scale = scales[site.kind, site.name]
                attached = effect.attach(site.name, scale)
                try:
                    attached.check(model)
                except ModelError:
                    continue  # it needs a second signal, which this model has not
                found.append(Candidate(Name(effect.id, site.name), attached, scale, _starts(effect)))
    return [*found, *_parameters(model)]


def _parameters(model: Model) -> list[Candidate]:
    """Parameters with a stated tolerance; what is free is recalibrated anyway, what is exact is no candidate."""
    return [
        Candidate(Name(one.name, one.name, "parameter"), None, None, ((),))
        for one in model.parameters
        if not isinstance(one.tolerance, str) and one.tolerance > 0
    ]


def _starts(effect: Effect) -> tuple[tuple[float, ...], ...]:
    """Return combinations of the starts, each at several sizes, within the bounds."""
    fitted = [parameter for parameter in effect.parameters if not parameter.held]
    combined = list(product(*(parameter.starts for parameter in fitted)))
    step = max(1, len(combined) // criteria.START_COMBINATIONS)
    found = []
    for start in combined[::step]:
        for size in criteria.START_SIZES:
            scaled = [
                value if parameter.neutral is None or not np.isfinite(parameter.neutral) else value * size
                for value, parameter in zip(start, fitted, strict=True)
            ]
            inside = tuple(
                round(min(max(value, parameter.lower), parameter.upper), 9)
                for value, parameter in zip(scaled, fitted, strict=True)
            )
            if inside not in found:
                found.append(inside)
    return tuple(found)


def without(everything: Sequence[Candidate], names: Collection[Name]) -> list[Candidate]:
    """Return the candidates that are not among `names`."""
    return [one for one in everything if one.name not in names]
