"""Shapes that are held at first: fitted where an effect explains much, and its usual shape leaves something over."""

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from labrun.fit.descent import minimise
from labrun.gap.candidates import Candidate
from labrun.gap.problem import own_states
from labrun.gap.screening import Base, Screened

if TYPE_CHECKING:
    from labrun.gap.guard import Guard

_LEAVES = 0.02
"""Part of what a candidate explains that has to be left over (beyond noise) before its shape is looked at."""
_PRICE = 10.0
"""By how much the sum of squares must fall for every shape that is fitted, in units of the noise's dispersion ..."""
_EARNS = 0.01
"""... and by which part of what the candidate explains."""
_ROUGH, _FEW = 1e-2, 12
_TOLERANCE, _EVALUATIONS = 1e-4, 30


def shaped(base: Base, screened: Screened, guard: "Guard") -> Screened:
    """Return the candidate with its shape fitted, if that explains clearly more; else as it was."""
    rows = sum(len(part) for part in base.residual)
    left = screened.squares - rows
    candidate = _with_shape(screened.candidate)
    if candidate is None or screened.gain < guard.threshold or left < _LEAVES * screened.gain:
        return screened
    problem = candidate.added_to(base.problem)
    size = base.problem.size
    shared, own = screened.z[:size], own_states(screened.problem, screened.z)
    ends = [
        minimise(
            problem,
            np.concatenate([shared, sizes, own]),
            tolerance=_ROUGH,
            evaluations=_FEW,
            central=False,
        )
        for sizes in _starts(candidate, screened)
    ]
    best = min(ends, key=problem.squares)
    z = minimise(problem, best, tolerance=_TOLERANCE, evaluations=_EVALUATIONS, central=False)
    squares = problem.squares(z)
    further = candidate.variables - screened.candidate.variables
    worth = max(_PRICE * guard.dispersion * further, _EARNS * screened.gain)
    if screened.squares - squares < worth:
        return screened
    return Screened(candidate, problem, z, squares, max(base.squares - squares, 0.0), screened.survey)


def _with_shape(candidate: Candidate) -> Candidate | None:
    """Return the candidate with its shape among what is fitted; None where it has none."""
    attached = candidate.attached
    if attached is None or not any(parameter.shape for parameter in attached.effect.parameters):
        return None
    parameters = tuple(
        replace(parameter, held=False) if parameter.shape else parameter
        for parameter in attached.effect.parameters
    )
    return replace(
        candidate, attached=replace(attached, effect=replace(attached.effect, parameters=parameters))
    )


def _starts(candidate: Candidate, screened: Screened) -> list[list[float]]:
    """Return the fitted sizes with every combination of the shapes' further starts."""
    assert candidate.attached is not None
    assert screened.candidate.attached is not None
    before = [not one.held for one in screened.candidate.attached.effect.parameters]
    fitted = iter(screened.sizes.tolist())
    choices = [
        (next(fitted),) if was else one.starts[1:]
        for one, was in zip(candidate.attached.effect.parameters, before, strict=True)
        if not one.held
    ]
    return [list(one) for one in product(*choices)]
