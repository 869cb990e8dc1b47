"""The threshold against false alarms: how much the best of all candidates would explain by chance alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.fit import Each, one_by_one
from labrun.gap import criteria
from labrun.gap.candidates import Candidate
from labrun.gap.null import Null, surrogate
from labrun.gap.screening import Base, Survey, refit, screen_all, survey


@dataclass(frozen=True)
class NoiseThreshold:
    """What chance alone would do.

    Attributes
    ----------
    gain
        Fall of the sum of squares that the best candidate must exceed.
    dispersion
        Mean energy of chance in one direction; 1 if noise is as white as it was taken to be.
    floor
        Sum of squares that noise alone leaves.
    squares
        Sum of squares of the base, where its size is not known to be that of noise or gap: what counts then is the
        part of it that a candidate removes. Infinite where noise is known.
    """

    gain: float
    dispersion: float
    floor: float = 0.0
    squares: float = np.inf

    def times(self, strictness: float) -> "NoiseThreshold":
        """Return a threshold that asks for so many times more."""
        if np.isinf(self.squares):
            return replace(self, gain=self.gain * strictness)
        odds = strictness * self._odds(self.gain)
        return replace(self, gain=self.squares * odds / (1.0 + odds))

    def evidence(self, gain: float) -> float:
        """Return how far a gain is beyond chance: above 1 it is. Where nothing shows at all, no gain is."""
        if self.gain <= 0.0:
            return 0.0
        return self._odds(gain) / self._odds(self.gain) if np.isfinite(self.squares) else gain / self.gain

    def log_likelihood(self, gain: float) -> float:
        """Return the tempered log likelihood that a gain adds; of noise of unknown size where it is not told."""
        if np.isinf(self.squares):
            return 0.5 * gain / self.dispersion
        left = max(1.0 - gain / self.squares, criteria.LEAST_LEFT)
        return -0.5 * self.squares / self.dispersion * float(np.log(left))

    def less_luck(self, gain: float, among: float) -> float:
        """Return a gain less what the best of so many tries gains by chance, twice their logarithm."""
        luck = 2.0 * self.dispersion * float(np.log(among))
        if np.isfinite(self.squares):
            luck = (self.squares - gain) * float(np.expm1(luck / self.squares))
        return max(gain - luck, 0.0)

    def _odds(self, gain: float) -> float:
        return gain / max(self.squares - gain, criteria.LEAST_LEFT * self.squares)


def full_strictness(
    base: Base,
    candidates: Sequence[Candidate],
    null: Null,
    linear: NoiseThreshold,
    rng: np.random.Generator,
    each: Each = one_by_one,
) -> float:
    """Return by what factor the linearised threshold has to grow, from the whole search run on chance alone.

    Data are made from the base's own prediction and noise redrawn from whole trials (or a surrogate of its residual);
    parameters are fitted again, every candidate is surveyed and fitted with all its variables, and the evidence of the
    best one kept.
    """
    simulated, problem = base.problem.simulated(base.z), base.problem
    most = []
    for _ in range(criteria.FULL_SEARCH_DRAWS):
        if null.relative:
            drawn = [
                one[: trial.outputs.size].reshape(trial.outputs.shape) / problem.noise.weights
                for one, trial in zip(surrogate(base, rng), problem.data.trials, strict=True)
            ]
        else:
            drawn = null.noise.draw(problem.data, rng)
        redrawn = problem.with_measured([one + other for one, other in zip(simulated, drawn, strict=True)])
        chance = Base.of(redrawn, refit(redrawn, base.z, tolerance=1e-4))
        surveys = each(lambda one, chance=chance: survey(chance, one), candidates)  # type: ignore[misc]
        squares = chance.squares if null.relative else np.inf
        scale = replace(linear, squares=squares, gain=linear.gain * min(squares / linear.squares, 1.0))
        found = screen_all(chance, surveys, scale.gain, each)
        most.append(max(scale.evidence(one.gain) for one in found))
    return max(1.0, float(np.percentile(most, criteria.NOISE_PERCENTILE)))


def noise_threshold(base: Base, surveys: Sequence[Survey], null: Null) -> NoiseThreshold:
    """Return the threshold from the linearised search: the whole library against draws of chance.

    Every candidate is stood for by the changes it makes at several sizes, so that one draw costs a few products of
    vectors. The gain is the energy of the draw in the best of them.
    """
    draws = null.draws(base)
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
    floor = null.floor(base.problem)
    if not null.relative:
        dispersion = max(1.0, float(np.mean(energies))) if energies else 1.0
        gain = float(np.percentile(most, criteria.NOISE_PERCENTILE))
        return NoiseThreshold(gain, dispersion, floor).times(criteria.LINEAR_SLACK)
    whole = np.sum(np.square(noise), axis=0)
    shares = most / np.where(whole > 0, whole, 1.0)
    dispersion = (
        float(np.mean(energies)) * base.squares / max(float(np.mean(whole)), 1e-300) if energies else 1.0
    )
    gain = base.squares * float(np.percentile(shares, criteria.NOISE_PERCENTILE))
    return NoiseThreshold(gain, dispersion, floor, base.squares).times(criteria.LINEAR_SLACK)
