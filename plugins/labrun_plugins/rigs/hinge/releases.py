"""Every release of a hinge fitted by itself, by simulation and by Fourier derivatives, and the mean over releases."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.devices import FloatArray
from labrun.errors import FitError
from labrun.fit import (
    Dataset,
    Estimate,
    FitTrial,
    NormalEquations,
    Problem,
    correlation_length,
    minimise,
    resample_trials,
)
from labrun.models import Model
from labrun_plugins.rigs.hinge.body import FOUND, Body
from labrun_plugins.rigs.hinge.fourier import FourierSwing

_SHARES = (0.1, 0.35)
"""Of a release, fitted first: over all of it a stiffness that is 1 % off already runs out of phase."""
_SWINGS_APART = 0.5
"""A residual of this share of the swing's own size is a swing out of phase, not a misfit."""


@dataclass(frozen=True, slots=True)
class Release:
    """One release, fitted by itself.

    Attributes
    ----------
    values, fourier : (2,)
        Stiffness (N m/rad) and damping (N m s/rad), by simulation and by Fourier derivatives.
    sigma : (2,)
        Standard deviation that the residual alone gives `values`.
    amplitude_rad
        Largest angle of the swing.
    simulated : (n, 1), initial_state : (2,)
    """

    values: FloatArray
    fourier: FloatArray
    sigma: FloatArray
    amplitude_rad: float
    simulated: FloatArray
    initial_state: FloatArray


def fit_release(model: Model, dataset: Dataset, trial: FitTrial, swing: FourierSwing, body: Body) -> Release:
    """Fit one release both ways; the body is taken as stated.

    Raises
    ------
    FitError
        No simulation of eq. (3.5) comes near this release.
    """
    fourier = fourier_values([swing], body)
    # whatever the series says, a spring and a damper are what the first guess is made of
    tiny = 1e-3 * np.array([abs(body.gravity_torque or 0.0), np.sqrt(body.inertia * max(fourier[0], 0.0))])
    start = dict(zip(FOUND, np.maximum(fourier, np.maximum(tiny, 1e-12)), strict=True))
    problem = Problem.of(model.with_values(start), replace(dataset, trials=(trial,)))
    z = np.concatenate([np.ones(len(FOUND)), problem.guess(problem.priors.values)])
    for share in _SHARES:
        z = minimise(problem.beginning(share), z, tolerance=1e-4, evaluations=15, central=False)
    z = minimise(problem, z, tolerance=1e-9, evaluations=40)
    parameters, own = problem.parameters(z), problem.own(z, 0)
    simulated = problem.simulate(parameters, 0, own)
    if simulated is None or problem.misfit(z) > _SWINGS_APART:
        raise FitError(
            f"eq. (3.5) does not follow {trial.label}: no stiffness and damping bring its simulation into phase",
            hint="look at that release: is the hinge flat where the angle is zero, and is the body let go freely "
            "at the very start? labrun can leave out trials that are marked rejected",
        )
    return Release(
        parameters[problem.priors.free],
        fourier,
        _sigma(problem, z),
        float(np.max(np.abs(simulated))),
        simulated,
        problem.initial_state(0, own),
    )


def _sigma(problem: Problem, z: FloatArray) -> FloatArray:
    """Return the standard deviations that the residual of one release gives its parameters."""
    jacobian = problem.jacobian(z, central=False)
    equations = NormalEquations.of(problem, z, jacobian)
    residual = jacobian.residual[0]
    variance = float(residual @ residual) / len(residual) * correlation_length([residual])
    across = equations.mixed[0]
    reduced = equations.shared - across.T @ np.linalg.solve(equations.own[0], across)
    spread: FloatArray = np.sqrt(variance * np.diag(np.linalg.inv(reduced))) * problem.priors.scale
    return spread


def fourier_system(swing: FourierSwing, body: Body) -> tuple[FloatArray, FloatArray]:
    """Return matrix and right side of eq. (3.5) as a linear equation in its unknowns, one row a sample.

    Unknown are stiffness and damping, and the gravity torque where it is not known.
    """
    columns = [swing.angle, swing.rate]
    right = -body.inertia * swing.acceleration
    if body.gravity_torque is None:
        columns.append(np.sin(swing.angle))
    else:
        right = right - body.gravity_torque * np.sin(swing.angle)
    return np.column_stack(columns), right


def fourier_values(swings: Sequence[FourierSwing], body: Body) -> FloatArray:
    """Return chapter 3's estimate from one or several swings: linear least squares in their derivatives."""
    systems = [fourier_system(swing, body) for swing in swings]
    matrix = np.vstack([matrix for matrix, _ in systems])
    return np.asarray(np.linalg.lstsq(matrix, np.concatenate([right for _, right in systems]), rcond=None)[0])


def mean_over_releases(
    values: FloatArray, units: Sequence[str], rng: np.random.Generator
) -> dict[str, Estimate]:
    """Return the mean of each quantity over releases, with 95 % intervals from resampling releases.

    Parameters
    ----------
    values : (T, 2)
        Stiffness and damping of every release; T at least 2.
    """
    mean = values.mean(axis=0)
    scale = np.maximum(np.abs(mean), 1e-300)
    information = np.broadcast_to(np.eye(len(scale)), (len(values), len(scale), len(scale)))
    resampled = resample_trials(np.array(information), (values - mean) / scale, rng=rng)
    return {
        name: Estimate(float(centre), (float(centre + low * size), float(centre + high * size)), unit)
        for name, unit, centre, size, low, high in zip(
            FOUND, units, mean, scale, resampled.low, resampled.high, strict=True
        )
    }
