"""Shapes that are held at first: fitted where an effect explains much, and its usual shape leaves something over."""

from dataclasses import replace
from itertools import product

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.levenberg_marquardt import minimise
from labrun.gap import criteria
from labrun.gap.candidates import Candidate
from labrun.gap.guard import Guard
from labrun.gap.screening import Base, Screened


def shaped(base: Base, screened: Screened, guard: Guard) -> Screened:
    """Return the candidate with its shape fitted, if that explains clearly more; else as it was."""
    rows = sum(len(part) for part in base.residual)
    left = screened.squares - rows
    found = _with_shape(screened.candidate)
    if found is None or screened.gain < guard.threshold or left < criteria.SHAPE_REMAINDER * screened.gain:
        return screened
    candidate, choices = found
    problem = candidate.added_to(base.problem)
    size = base.problem.size
    shared, own = screened.z[:size], screened.problem.own_states(screened.z)
    ends = [
        minimise(
            problem,
            np.concatenate([shared, sizes, own]),
            tolerance=criteria.ROUGH_TOLERANCE,
            evaluations=criteria.ROUGH_EVALUATIONS,
            central=False,
        )
        for sizes in _starts(choices, screened.sizes)
    ]
    best = min(ends, key=problem.squares)
    z = minimise(
        problem, best, tolerance=criteria.FIT_TOLERANCE, evaluations=criteria.FIT_EVALUATIONS, central=False
    )
    squares = problem.squares(z)
    further = candidate.variables - screened.candidate.variables
    worth = max(criteria.SHAPE_PRICE * guard.dispersion * further, criteria.SHAPE_EARNS * screened.gain)
    if screened.squares - squares < worth:
        return screened
    return Screened(candidate, problem, z, squares, max(base.squares - squares, 0.0), screened.survey)


def _with_shape(candidate: Candidate) -> tuple[Candidate, list[tuple[float, ...]]] | None:
    """Return the candidate with its shapes among what is fitted, and the starts of every variable; None if it has none.

    The starts of what is fitted anyway are left open (empty).
    """
    attached = candidate.attached
    if attached is None or not any(parameter.shape for parameter in attached.effect.parameters):
        return None
    parameters = attached.effect.parameters
    freed = tuple(replace(one, held=False) if one.shape else one for one in parameters)
    choices = [one.starts[1:] if one.shape else () for one in parameters if one.shape or not one.held]
    effect = replace(attached.effect, parameters=freed)
    return replace(candidate, attached=replace(attached, effect=effect)), choices


def _starts(choices: list[tuple[float, ...]], sizes: FloatArray) -> list[tuple[float, ...]]:
    """Return the fitted sizes with every combination of the shapes' starts."""
    fitted = iter(sizes.tolist())
    return list(product(*(choice or (next(fitted),) for choice in choices)))
