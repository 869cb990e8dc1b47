"""What data know of a size: the information about one variable once all others have adapted."""

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.fit.jacobian import Jacobian
from labrun.fit.levenberg_marquardt import NormalEquations
from labrun.fit.problem import Problem
from labrun.gap import criteria

_RIDGE = 1e-12


def information(problem: Problem, z: FloatArray, jacobian: Jacobian) -> FloatArray:
    """Return the information about every shared variable, parameters and initial states adapting, shape (p,).

    It is the inverse of the variance that the variable would have in units of white noise.
    """
    equations = NormalEquations.of(problem, z, jacobian)
    reduced = equations.shared
    if equations.own.shape[1]:
        own = equations.own + _RIDGE * np.eye(equations.own.shape[1])
        reduced = reduced - np.einsum("tqp,tqr->pr", equations.mixed, np.linalg.solve(own, equations.mixed))
    size = np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    correlation = reduced / np.outer(size, size) + _RIDGE * np.eye(len(size))
    found: FloatArray = size**2 / np.maximum(np.diag(np.linalg.inv(correlation)), 1.0)
    return found


def unseen(problem: Problem, whole: FloatArray, part: FloatArray) -> NDArray[np.bool_]:
    """Tell which variables are sizes of effects that a part of the data knows next to nothing of, shape (p,).

    Parameters
    ----------
    whole, part : (p,)
        `information` of all data, and of the part.
    """
    effects = sum(not one.held for attached in problem.effects for one in attached.effect.parameters)
    of_effects = np.arange(problem.size) >= problem.size - effects
    found: NDArray[np.bool_] = of_effects & (part < criteria.LEAST_INFORMATION * whole)
    return found
