"""Whether a simulation forgets how it began, or runs away from it: then no fit follows what was measured for long."""

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.problem import Problem
from labrun.models import simulate

_NUDGE = 1e-7
"""Of every state's own course, so small that it grows as a linearised model says."""
_GROWN, _GROWN_FAR = 1e2, 1e4
"""How many times greater than it was a nudge becomes: what is unstable grows so; far more leaves no doubt."""
_LATE = 5.0
"""A nudge of an unstable model grows more than so many times in the second half; that of an integrator twice."""


def divergence_warnings(problem: Problem, z: FloatArray) -> list[str]:
    """Return a sentence if simulations of the longest trial that begin almost alike part by orders of magnitude."""
    model = problem.model
    if not model.states:
        return []
    index = int(np.argmax([trial.time_s[-1] - trial.time_s[0] for trial in problem.data.trials]))
    trial, parameters = problem.data.trials[index], problem.parameters(z)
    begin = problem.initial_state(index, problem.own(z, index))

    def course(start: FloatArray) -> FloatArray:
        return simulate(
            model, trial.time_s, problem.drives[index], parameters=parameters[: len(model.parameters)],
            condition=trial.condition, initial_state=start,
        ).states  # fmt: skip

    first = course(begin)
    size = np.std(first, axis=0)
    moving = size > 0
    if not np.isfinite(size).all() or not moving.any():
        return []
    second = course(begin + _NUDGE * size)
    grown = np.max(np.abs(second - first)[:, moving] / size[moving], axis=1) / _NUDGE
    if not np.isfinite(grown).all():
        return []
    half = len(grown) // 2
    early, most = max(float(np.max(grown[:half], initial=1.0)), 1.0), float(np.max(grown))
    if most < _GROWN or (most < _GROWN_FAR and most < _LATE * early):
        return []
    return [
        f"the simulation diverges: by its inputs alone an error at the beginning grows {most:.1g}-fold in "
        f"{trial.label}, and no simulation follows what was measured: do not rely on fitted values. "
        "labrun gap diagnose keeps a plant that a controller held on course by what was measured; "
        "or cut far shorter trials"
    ]
