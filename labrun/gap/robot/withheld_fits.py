"""Parameters and causes of one joint, fitted without a part of the log at a time.

Each joint has several corrections: its causes alone, with the parameters of which nothing is stated, and with all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.effects import AttachedEffect
from labrun.errors import LabrunError
from labrun.fit import Problem, minimise
from labrun.gap import criteria, numerics
from labrun.gap.candidates import site_scales
from labrun.gap.held_out import mean_residuals
from labrun.gap.noise import of_sensor
from labrun.gap.recalibration import in_units_of, stated_problem
from labrun.gap.robot.one_joint import OneJoint
from labrun.gap.robot.together import with_rate_gain_as_damping

_Moved = Literal["none", "free", "all"]
"""Which stated parameters are fitted beside causes: none, those of which nothing is stated, or all."""


@dataclass(frozen=True)
class Correction:
    """Parameters of a joint, those that were moved, and the causes there.

    Attributes
    ----------
    size
        Number of fitted values.
    causes
        Number of parameters among them that are causes themselves.
    """

    values: Mapping[str, float]
    effects: tuple[AttachedEffect, ...]
    size: int
    causes: int = 0

    @property
    def words(self) -> str:
        """What of a joint it corrects: "as stated", "causes", "parameters" or both."""
        parts = ["causes"] * bool(self.effects or self.causes)
        parts += ["parameters"] * (len(self.values) > self.causes)
        return " and ".join(parts) or "as stated"


def corrections(
    joint: OneJoint,
    effects: Sequence[AttachedEffect],
    released: Sequence[str],
    corrected: Mapping[str, float],
    fold: IntArray,
) -> list[list[Correction]]:
    """Return every correction of a joint, the simplest first: fitted without each fold, then to everything.

    Parameters
    ----------
    released
        Parameters that are causes themselves: further from what is stated than their tolerance allows.
    """
    folds = int(fold.max()) + 1
    nothing = [Correction({}, (), 0)] * (folds + 1)
    problem, start = problem_of(joint, effects, released, corrected)
    if problem is None:
        values = {
            parameter.name: corrected[parameter.name]
            for parameter in joint.model.parameters
            if parameter.name in corrected and corrected[parameter.name] != parameter.value
        }
        count = len(values) + sum(len(effect.values) for effect in effects)
        return [nothing, [Correction(values, tuple(effects), count)] * (folds + 1)] if count else [nothing]
    kinds: list[_Moved] = ["none", "free", "all"] if effects or released else ["free", "all"]
    fitted, moved_before = [nothing], -1
    for kind in kinds:
        moved = _variables_moved(problem, kind, released)
        if int(moved.sum()) == moved_before or not (effects or moved.any()):
            continue
        moved_before = int(moved.sum())
        withheld = [_fitted(problem, start, moved, fold != number, released) for number in range(folds)]
        fitted.append([*withheld, _fitted(problem, start, moved, fold >= 0, released)])
    return fitted


def problem_of(
    joint: OneJoint,
    effects: Sequence[AttachedEffect],
    released: Sequence[str],
    corrected: Mapping[str, float],
) -> tuple[Problem | None, FloatArray]:
    """Return the problem of a joint with its causes, and where its diagnosis ended; None if it does not simulate."""
    trials = tuple(
        replace(trial, members=trial.members or (trial.outputs,)) for trial in joint.dataset.trials
    )
    plain = stated_problem(joint.model, replace(joint.dataset, trials=trials))
    try:
        scales = site_scales(plain, plain.begin())
        problem = plain.with_effects(effects, [scales[effect.effect.kind, effect.site] for effect in effects])
        for parameter in joint.model.parameters:
            if parameter.name in released:
                problem = replace(problem, priors=problem.priors.releasing(parameter, criteria.FAR_OFF))
        own = np.array([corrected.get(each.name, each.value) for each in joint.model.parameters])
        values = np.concatenate([own, *(effect.values for effect in effects)])
        shared = np.clip(
            values[problem.priors.free] / problem.priors.scale, problem.priors.lower, problem.priors.upper
        )
        start = np.concatenate([shared, problem.guess(problem.parameters(shared))])
        problem = problem.refined(start)
        residual = mean_residuals(problem, start)
        return in_units_of(of_sensor(problem.data, residual), problem, start), start
    except (KeyError, LabrunError):
        return None, np.empty(0)


def _variables_moved(problem: Problem, kind: _Moved, released: Sequence[str]) -> Any:
    priors = problem.priors
    of_model = priors.free < len(problem.model.parameters)
    free = ~np.isfinite(priors.sigma)
    if kind == "all":
        return of_model
    cause = np.array([name in released for name in priors.names], dtype=bool)
    return of_model & (cause if kind == "none" else free | cause)


def _fitted(
    problem: Problem, start: FloatArray, moved: Any, seen: Any, released: Sequence[str]
) -> Correction:
    """Return the fit to the trials that are seen; parameters that may not move stay as stated."""
    priors, size = problem.priors, problem.size
    count = len(problem.model.parameters)
    stays = (priors.free < count) & ~moved
    chosen = [index for index in range(len(problem.data.trials)) if seen[index]]
    own = start[size:].reshape(len(problem.data.trials), problem.own_size)[chosen]
    shared = np.where(stays, priors.stated, start[:size])
    part = problem.part(chosen)
    end = minimise(
        part,
        np.concatenate([shared, own.ravel()]),
        lower=np.where(stays, shared, priors.lower),
        upper=np.where(stays, shared, priors.upper),
        tolerance=numerics.FIT_TOLERANCE,
        evaluations=numerics.FIT_EVALUATIONS,
        central=False,
        secant=True,
        confirmed=False,
    )
    parameters = part.parameters(end)
    names = [parameter.name for parameter in problem.model.parameters]
    values = {names[index]: float(parameters[index]) for index in priors.free[moved].tolist()}
    size = int(moved.sum() + np.sum(priors.free >= count))
    causes = sum(name in released for name in values)
    stated = {parameter.name: parameter.value for parameter in problem.model.parameters}
    values = with_rate_gain_as_damping(values, stated)
    return Correction(values, part.attached(parameters), size, causes)
