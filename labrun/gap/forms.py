"""Other forms of a candidate: a wider range, shorter integration steps, fitted shapes, fewer levels."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import EffectParameter
from labrun.fit import Problem, minimise
from labrun.gap import numerics
from labrun.gap.candidates import Candidate
from labrun.gap.screening import Base, Screened, derivatives_around
from labrun.gap.steps import in_shorter_steps

_WIDENINGS = 3
"""Times that a range is widened at most, where a fit ended near its far end."""
_WIDER = 5.0
"""Factor by which it is widened."""
_NEAR_THE_END = 0.1
"""Part of the range within which a fit counts as having ended near its end."""


def in_fitting_range(base: Base, screened: Screened) -> Screened:
    """Return a candidate fitted within a range that holds its optimum, in steps that resolve its force."""
    return _resolved(base, _widened(base, _resolved(base, _widened(base, screened))))


def forms_of(base: Base, screened: Screened, *, shapes: bool) -> Iterator[tuple[bool, Screened]]:
    """Yield other forms of a candidate, each with whether it is richer than the usual one.

    Richer forms have a shape (an exponent, a transition speed) among what is fitted; poorer ones lack one of several
    levels: an end stop on one side only.

    Parameters
    ----------
    shapes
        Whether to fit shapes, too.
    """
    for name in _levels(screened.candidate):
        yield False, _without_level(base, screened, name)
    for candidate, choices in _with_shape(screened.candidate) if shapes else ():
        if _fitted(candidate) != _fitted(screened.candidate):
            yield True, _resolved(base, _shape_fitted(base, screened, candidate, choices))


def _widened(base: Base, screened: Screened) -> Screened:
    """Return a candidate fitted in a wider range, where its size ended at the far end of what was searched.

    The typical size at a site comes from the model as it is: play in a joint that is rigid there goes far beyond its
    wind-up.
    """
    for _ in range(_WIDENINGS):
        attached = screened.candidate.attached
        if attached is None:
            break
        sizes = iter(screened.sizes.tolist())
        parameters = tuple(
            parameter if parameter.held else _further(parameter, next(sizes))
            for parameter in attached.effect.parameters
        )
        if parameters == attached.effect.parameters:
            break
        candidate = replace(
            screened.candidate,
            attached=replace(attached, effect=replace(attached.effect, parameters=parameters)),
        )
        problem = candidate.added_to(base.problem).in_steps_of(screened.problem)
        screened = replace(_followed(base, screened, problem, screened.z), candidate=candidate)
    return screened


def _further(parameter: EffectParameter, size: float) -> EffectParameter:
    if parameter.quantity == "ratio" or (parameter.neutral != 0.0 and parameter.quantity != "stiffness"):
        return parameter
    if parameter.lower < 0.0 and size <= (1.0 - _NEAR_THE_END) * parameter.lower:
        return replace(parameter, lower=_WIDER * parameter.lower)
    if size < (1.0 - _NEAR_THE_END) * parameter.upper:
        return parameter
    return replace(parameter, upper=_WIDER * parameter.upper)


def _resolved(base: Base, screened: Screened) -> Screened:
    """Return a candidate fitted with integration steps as short as its force asks for.

    Friction that holds a joint still, or a stiff stop, needs shorter steps than the base near the reversals where it
    acts.
    """
    while screened.candidate.attached is not None:
        finer = in_shorter_steps(screened.problem, screened.z, numerics.STEPS_DO * screened.squares)
        if finer is screened.problem:
            break
        screened = _followed(base, screened, finer, screened.z)
    return screened


def _followed(base: Base, screened: Screened, problem: Problem, start: FloatArray) -> Screened:
    z = minimise(
        problem,
        start,
        tolerance=numerics.FIT_TOLERANCE,
        evaluations=numerics.FIT_EVALUATIONS,
        central=False,
        secant=True,
        given_jacobian=derivatives_around(base, screened.candidate),
        renewals=numerics.FIT_RENEWALS,
    )
    squares = problem.squares(z)
    return replace(screened, problem=problem, z=z, squares=squares, gain=max(base.squares - squares, 0.0))


def _shape_fitted(
    base: Base, screened: Screened, candidate: Candidate, choices: list[tuple[float, ...]]
) -> Screened:
    """Return a candidate with its shapes among what is fitted, from the best of their starts."""
    size = base.problem.size
    shared, own = screened.z[:size], screened.problem.own_states(screened.z)
    around = derivatives_around(base, screened.candidate)
    sizes = {
        parameter.name: value
        for parameter, value in zip(_fitted(screened.candidate), screened.sizes.tolist(), strict=True)
    }
    problem = candidate.added_to(base.problem).in_steps_of(screened.problem)
    ends = [
        minimise(
            problem,
            np.concatenate([shared, start, own]),
            tolerance=numerics.ROUGH_TOLERANCE,
            evaluations=numerics.ROUGH_EVALUATIONS,
            central=False,
            secant=around is not None,
            confirmed=around is None,
            given_jacobian=around,
        )
        for start in _starts(candidate, choices, sizes)
    ]
    return replace(_followed(base, screened, problem, min(ends, key=problem.squares)), candidate=candidate)


def _without_level(base: Base, screened: Screened, name: str) -> Screened:
    """Return an effect of several levels with one of them out of reach."""
    candidate = _out_of_reach(screened.candidate, name)
    problem = candidate.added_to(base.problem).in_steps_of(screened.problem)
    fitted = [parameter.name for parameter in _fitted(screened.candidate)]
    sizes = np.delete(screened.sizes, fitted.index(name))
    start = np.concatenate([screened.z[: base.problem.size], sizes, screened.problem.own_states(screened.z)])
    return replace(_followed(base, screened, problem, start), candidate=candidate)


def _fitted(candidate: Candidate) -> list[EffectParameter]:
    attached = candidate.attached
    return [] if attached is None else [item for item in attached.effect.parameters if not item.held]


def _levels(candidate: Candidate) -> list[str]:
    """Return the fitted parameters that are out of reach without the effect, if there is more than one."""
    names = [item.name for item in _fitted(candidate) if item.neutral is not None and np.isinf(item.neutral)]
    return names if len(names) > 1 else []


def _out_of_reach(candidate: Candidate, name: str) -> Candidate:
    attached, scale = candidate.attached, candidate.scale
    if attached is None or scale is None:
        return candidate
    parameters, values = list(attached.effect.parameters), list(attached.values)
    index = [item.name for item in parameters].index(name)
    parameter = parameters[index]
    far = parameter.upper if parameter.neutral == np.inf else parameter.lower
    parameters[index], values[index] = replace(parameter, held=True), far * scale.of(parameter.quantity)
    effect = replace(attached.effect, parameters=tuple(parameters))
    return replace(candidate, attached=replace(attached, effect=effect, values=tuple(values)))


def _with_shape(candidate: Candidate) -> list[tuple[Candidate, list[tuple[float, ...]]]]:
    """Return the candidate with its shapes among what is fitted, and the starts of every variable; one for each choice.

    A shape that stands in for another one makes a candidate of its own. The starts of what is fitted anyway are left
    open (empty).
    """
    attached = candidate.attached
    if attached is None:
        return []
    shapes = [parameter for parameter in attached.effect.parameters if parameter.shape]
    variants = []
    for choice in dict.fromkeys(parameter.instead_of for parameter in shapes):
        free = {
            parameter.name
            for parameter in shapes
            if parameter.instead_of in {"", choice} and parameter.name != choice
        }
        parameters = tuple(_settled(parameter, free) for parameter in attached.effect.parameters)
        choices = [
            parameter.starts[1:] if parameter.name in free else ()
            for parameter in parameters
            if not parameter.held
        ]
        effect = replace(attached.effect, parameters=parameters)
        variants.append((replace(candidate, attached=replace(attached, effect=effect)), choices))
    return variants


def _settled(parameter: EffectParameter, free: Collection[str]) -> EffectParameter:
    """Return a parameter that is fitted if it is among these, and is no open shape any more if it is not."""
    if not parameter.shape:
        return parameter
    if parameter.name in free:
        return replace(parameter, held=False)
    return replace(parameter, starts=parameter.starts[:1])


def _starts(
    candidate: Candidate, choices: list[tuple[float, ...]], sizes: Mapping[str, float]
) -> list[tuple[float, ...]]:
    """Return the fitted sizes with every combination of the shapes' starts."""
    pairs = zip(_fitted(candidate), choices, strict=True)
    return list(product(*(choice or (sizes[parameter.name],) for parameter, choice in pairs)))
