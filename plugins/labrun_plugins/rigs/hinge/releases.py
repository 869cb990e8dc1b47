"""Every release of a hinge fitted by itself, by simulation and by Fourier derivatives, and the mean over releases."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

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

ComplexArray = NDArray[np.complex128]

_EXTENSION = 1.25
"""Fundamental period over record length."""
_LOWEST, _HIGHEST = 1.5, 4.0
"""Range of the highest harmonic, in units of the swing's own frequency."""
_RIDGE = 1e-13
"""Squared singular values below this share of the number of samples count as nothing."""
_TRIM = 0.05


@dataclass(frozen=True, slots=True)
class FourierSwing:
    """A swing and its derivatives, away from the ends of the record.

    Attributes
    ----------
    time_s, angle, rate, acceleration : (n,)
        rad, rad/s, rad/s^2.
    order
        Number of harmonics.
    noise
        Root mean square of what the series leaves, rad: the sensor's noise, if the series follows the swing.
    """

    time_s: FloatArray
    angle: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    order: int
    noise: float


def fit_fourier(time_s: FloatArray, angle: FloatArray, label: str = "the record") -> FourierSwing:
    """Fit a Fourier series to one decaying swing by least squares and differentiate it.

    A decaying record is not periodic, and a series over its own length would ring at both ends. The series is
    therefore given a fundamental period 1.25 times the record's length (a Fourier extension: Boyd 2002,
    Huybrechs 2010), in whose free quarter it may close as it likes; the least-squares problem is then ill-conditioned,
    which a slight ridge takes care of. The order is the one with the smallest Bayesian information criterion between
    1.5 and 4 times the swing's own frequency: higher harmonics would only follow noise, which two differentiations
    multiply.
    Derivatives are least certain at the ends: 5 % of the record, or half a swing if that is longer, is dropped at each.

    Parameters
    ----------
    time_s : (n,)
        Need not be evenly spaced.
    angle : (n,)
        rad.

    Raises
    ------
    FitError
        Too short a record: less than three swings, or less than eight samples a swing.
    """
    duration_s = float(time_s[-1] - time_s[0])
    frequency_hz = _dominant_frequency(time_s, angle)
    per_swing = len(time_s) / (duration_s * frequency_hz)
    if duration_s * frequency_hz < 3.0 or per_swing < 8.0:
        raise FitError(
            f"{label} holds {duration_s * frequency_hz:.1f} swings of {per_swing:.0f} samples: "
            "too little for a Fourier series",
            hint="record at least three swings, at eight samples a swing or more",
        )
    period_s = _EXTENSION * duration_s
    lowest = max(int(_LOWEST * frequency_hz * period_s), 2)
    highest = int(min(_HIGHEST * frequency_hz * period_s, len(time_s) / 4))
    centred = time_s - 0.5 * (time_s[0] + time_s[-1])
    waves = _waves(centred, period_s, max(highest, lowest))
    order, coefficients = _series(waves, angle, lowest)
    noise = float(np.sqrt(np.mean((angle - (waves[:, : order + 1] @ coefficients).real) ** 2)))
    trim_s = max(_TRIM * duration_s, 0.5 / frequency_hz)
    inside = np.abs(centred) <= 0.5 * duration_s - trim_s
    turn = 2j * np.pi / period_s * np.arange(order + 1)
    values = waves[inside, : order + 1] @ np.column_stack(
        [coefficients, turn * coefficients, turn**2 * coefficients]
    )
    return FourierSwing(time_s[inside], values[:, 0].real, values[:, 1].real, values[:, 2].real, order, noise)


def _waves(time_s: FloatArray, period_s: float, highest: int) -> ComplexArray:
    """Return exp(i m w t) for m = 0 ... highest as columns, by repeated multiplication."""
    waves = np.ones((len(time_s), highest + 1), dtype=complex)
    waves[:, 1] = np.exp(2j * np.pi / period_s * time_s)
    known = 1
    while known < highest:
        new = min(known, highest - known)
        waves[:, known + 1 : known + 1 + new] = waves[:, 1 : new + 1] * waves[:, known : known + 1]
        known += new
    return waves


def _series(waves: ComplexArray, angle: FloatArray, lowest: int) -> tuple[int, ComplexArray]:
    """Return the order of smallest BIC and its complex coefficients (angle = Re sum c_m exp(i m w t)).

    Products of two waves are waves, so that the normal equations need the sums of single waves only; one Cholesky
    factor of the largest holds the factors, and so the residuals, of all smaller ones.
    """
    number, highest = len(angle), waves.shape[1] - 1
    sums = np.concatenate([waves.sum(axis=0), waves[:, 1:].T @ waves[:, -1]])
    gram = _gram(sums, highest)
    gram[np.diag_indices_from(gram)] += _RIDGE * number
    pulls = angle @ waves
    right = np.empty(2 * highest + 1)
    right[0], right[1::2], right[2::2] = pulls[0].real, pulls[1:].real, -pulls[1:].imag
    factor = cholesky(gram, lower=True)
    forward = solve_triangular(factor, right, lower=True)
    orders = np.arange(lowest, highest + 1)
    total = float(angle @ angle)
    left = np.maximum(total - np.cumsum(forward**2)[2 * orders], 1e-20 * total)
    criterion = number * np.log(left / number) + np.log(number) * (2 * orders + 1)
    order = int(orders[np.argmin(criterion)])
    size = 2 * order + 1
    solved = solve_triangular(factor[:size, :size], forward[:size], lower=True, trans="T")
    return order, np.concatenate([solved[:1], solved[1::2] + 1j * solved[2::2]])


def _gram(sums: ComplexArray, highest: int) -> FloatArray:
    """Return B'B of the basis 1, cos, -sin, cos 2, -sin 2, ... from the sums of exp(i m w t)."""
    index = np.arange(highest + 1)
    apart = index[:, None] - index
    difference = np.where(apart >= 0, sums[np.abs(apart)], np.conj(sums[np.abs(apart)]))
    together = sums[index[:, None] + index]
    gram = np.empty((2 * highest + 2, 2 * highest + 2))
    gram[0::2, 0::2] = 0.5 * (together + difference).real
    gram[1::2, 1::2] = 0.5 * (difference - together).real
    gram[1::2, 0::2] = -0.5 * (together + difference).imag
    gram[0::2, 1::2] = gram[1::2, 0::2].T
    # the sine of order zero is no part of the basis
    return np.delete(np.delete(gram, 1, axis=0), 1, axis=1)


def _dominant_frequency(time_s: FloatArray, angle: FloatArray) -> float:
    """Return the frequency of the largest peak of the spectrum, Hz."""
    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    values = np.interp(even, time_s, angle)
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)), 4 * len(values)))
    frequencies = np.fft.rfftfreq(4 * len(values), even[1] - even[0])
    # below one swing per record lies drift, not a swing
    spectrum[frequencies < 1.0 / (even[-1] - even[0])] = 0.0
    return float(frequencies[np.argmax(spectrum)])


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

    Raises FitError: no simulation of eq. (3.5) comes near this release.
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
