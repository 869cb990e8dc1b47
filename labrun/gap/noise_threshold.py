"""The threshold against false alarms: how much the best of all candidates would explain of noise alone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Each, Problem, one_by_one
from labrun.gap import criteria
from labrun.gap.candidates import Candidate
from labrun.gap.noise import Noise
from labrun.gap.screening import Base, Survey, refit, screen_all, survey


@dataclass(frozen=True)
class NoiseThreshold:
    """What noise alone would do.

    Attributes
    ----------
    gain
        Fall of the sum of squares that the best candidate must exceed.
    dispersion
        Mean energy of the noise in one direction; 1 if the noise is as white as it was taken to be.
    """

    gain: float
    dispersion: float

    def times(self, strictness: float) -> "NoiseThreshold":
        """Return a threshold that asks for so many times more."""
        return NoiseThreshold(self.gain * strictness, self.dispersion)


def noise_draws(problem: Problem, noise: Noise, rng: np.random.Generator) -> list[list[FloatArray]]:
    """Return whitened noise of the mean of every unit, as the residuals of `problem` see it, for every draw."""
    behind = np.zeros(len(problem.states.read))  # no noise is drawn for what is read of initial states
    found = []
    for _ in range(criteria.NOISE_DRAWS):
        parts = []
        for index, drawn in enumerate(noise.draw(problem.data, rng)):
            white = problem.whiten(drawn * problem.noise.weights, index).ravel()
            parts.append(np.concatenate([white, behind]))
        found.append(parts)
    return found


def full_strictness(
    base: Base,
    candidates: Sequence[Candidate],
    noise: Noise,
    linear: NoiseThreshold,
    rng: np.random.Generator,
    each: Each = one_by_one,
) -> float:
    """Return by what factor the linearised threshold has to grow, from the whole search run on noise alone.

    Data are made from the base's own prediction and noise redrawn from whole trials; parameters are fitted again, every
    candidate is surveyed and fitted with all its variables, and the gain of the best one kept.
    """
    simulated = base.problem.simulated(base.z)
    most = []
    for _ in range(criteria.FULL_SEARCH_DRAWS):
        drawn = noise.draw(base.problem.data, rng)
        problem = base.problem.with_measured(
            [one + other for one, other in zip(simulated, drawn, strict=True)]
        )
        null = Base.of(problem, refit(problem, base.z, tolerance=1e-4))
        surveys = each(lambda one, null=null: survey(null, one), candidates)  # type: ignore[misc]
        most.append(max(one.gain for one in screen_all(null, surveys, linear.gain, each)))
    return max(1.0, float(np.percentile(most, criteria.NOISE_PERCENTILE)) / linear.gain)


def noise_threshold(
    base: Base, surveys: Sequence[Survey], draws: Sequence[Sequence[FloatArray]]
) -> NoiseThreshold:
    """Return the threshold from the linearised search: the whole library against noise drawn from the data's own.

    Every candidate is stood for by the changes it makes at several sizes, so that one draw costs a few products of
    vectors. The gain is the energy of the noise in the best of them.
    """
    units = len(base.residual)
    stacked = [np.column_stack([draw[unit] for draw in draws]) for unit in range(units)]
    noise = base.nuisance.remainder(stacked)
    most = np.zeros(len(draws))
    energies = []
    for one in surveys:
        lines = one.lines
        if lines.shape[1] == 0:
            continue
        along = np.square(lines.T @ noise)
        energies.append(np.mean(along))
        gain = np.max(along, axis=0)
        variables = one.candidate.variables
        if variables > 1:
            plane = np.linalg.qr(lines[:, :variables])[0]
            gain = np.maximum(gain, np.sum(np.square(plane.T @ noise), axis=0))
        most = np.maximum(most, gain)
    dispersion = max(1.0, float(np.mean(energies))) if energies else 1.0
    return NoiseThreshold(
        criteria.LINEAR_SLACK * float(np.percentile(most, criteria.NOISE_PERCENTILE)), dispersion
    )
