"""The threshold against false alarms: how much the best of all candidates would explain by chance alone."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.fit import Each, Problem, one_by_one
from labrun.gap import criteria
from labrun.gap.candidates import Candidate
from labrun.gap.noise import Noise
from labrun.gap.screening import Base, Survey, refit, screen_all, survey

Draws = Sequence[Sequence[FloatArray]]


@dataclass(frozen=True)
class Null:
    """Draws of what candidates have to beat, as the residuals of a problem see them.

    Attributes
    ----------
    seed
        Of the surrogates, which are drawn anew for every base.
    """

    noise: Noise
    repeated: Draws
    seed: int
    _kept: dict[int, tuple[Base, Draws]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, problem: Problem, noise: Noise, rng: np.random.Generator) -> "Null":
        """Take the noise of a recalibrated problem."""
        repeated = noise_draws(problem, noise, rng) if noise.known else ()
        return cls(noise, repeated, int(rng.integers(2**31)))

    @property
    def relative(self) -> bool:
        """Whether draws are surrogates of a base's own residual, of which shares count, not sizes."""
        return not self.noise.known

    def draws(self, base: Base) -> Draws:
        """Return whitened residuals of every unit, for every draw."""
        if not self.relative:
            return self.repeated
        if id(base) not in self._kept:
            rng = np.random.default_rng(self.seed)
            drawn = [surrogate(base, rng) for _ in range(criteria.NOISE_DRAWS)]
            self._kept[id(base)] = (base, drawn)
        return self._kept[id(base)][1]

    def floor(self, problem: Problem) -> float:
        """Return the sum of squared residuals that noise alone would leave."""
        samples = sum(len(trial.outputs) for trial in problem.data.trials)
        if not self.relative:
            return float(samples * len(self.noise.sd))
        return samples * float(np.sum(np.square(self.noise.sd * problem.noise.weights)))


def noise_draws(problem: Problem, noise: Noise, rng: np.random.Generator) -> list[list[FloatArray]]:
    """Return whitened noise of the mean of every unit, as the residuals of `problem` see it, for every draw."""
    behind = np.zeros(problem.behind)  # no noise is drawn for what is known of the trial's own variables
    found = []
    for _ in range(criteria.NOISE_DRAWS):
        parts = []
        for index, drawn in enumerate(noise.draw(problem.data, rng)):
            white = problem.whiten(drawn * problem.noise.weights, index).ravel()
            parts.append(np.concatenate([white, behind]))
        found.append(parts)
    return found


def surrogate(base: Base, rng: np.random.Generator) -> list[FloatArray]:
    """Return a base's residual with the spectrum of every trial and phases drawn at random, one set for all outputs.

    A mean over a trial has no phase. What the means of several trials have in common is chance once they are turned
    all together by a random rotation (Langsrud, Statistics and Computing 15 (2005) 53), which for one constant offset
    is Student's test; the mean of a single trial is drawn as large as its slowest waves are.
    """
    shapes = [trial.outputs.shape for trial in base.problem.data.trials]
    pairs = list(zip(base.residual, shapes, strict=True))
    spectra = [np.fft.rfft(one[: n * m].reshape(n, m), axis=0) for one, (n, m) in pairs]
    means = means_by_chance(spectra, np.array([float(n) for n, _ in shapes]), rng)
    found = []
    for (residual, (samples, _)), spectrum, mean in zip(pairs, spectra, means, strict=True):
        turned = spectrum * np.exp(2j * np.pi * rng.random(len(spectrum)))[:, None]
        turned[0] = mean
        if samples % 2 == 0:
            turned[-1] = spectrum[-1] * rng.choice([-1.0, 1.0])
        drawn = np.fft.irfft(turned, n=samples, axis=0).ravel()
        found.append(np.concatenate([drawn, np.zeros(len(residual) - len(drawn))]))
    return found


def means_by_chance(
    spectra: Sequence[NDArray[np.complex128]], samples: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return the values of spectra (n/2 + 1, m) at zero frequency as chance would have them, (trials, m).

    Parameters
    ----------
    samples : (trials,)
        How many each spectrum is of.
    """
    if len(spectra) == 1:
        slowest = spectra[0][1 : 1 + criteria.SLOWEST_WAVES]
        size = np.sqrt(np.mean(np.square(np.abs(slowest)), axis=0)) if len(slowest) else np.abs(spectra[0][0])
        return np.asarray(rng.standard_normal() * size)[None, :]
    means = np.array([one[0].real for one in spectra]) / np.sqrt(samples)[:, None]
    inside, outside = np.linalg.qr(means)
    frame = np.linalg.qr(rng.standard_normal(inside.shape))[0] * rng.choice([-1.0, 1.0], inside.shape[1])
    return np.asarray(frame @ outside * np.sqrt(samples)[:, None])


def independent_share(residual: Sequence[FloatArray]) -> float:
    """Return how many independent numbers there are to each sample of residuals (n, m), by their spectra.

    White noise has one; a single sine two in a whole trial.
    """
    energies, freedoms = [], []
    for one in residual:
        for column in one.T:
            power = np.square(np.abs(np.fft.rfft(column)))
            power[0] *= 0.5
            total = float(np.sum(power))
            if total > 0:
                energies.append(total)
                # powers of noise scatter by as much as they are: their mean square is twice the spectrum's
                freedom = 4.0 * total**2 / float(np.sum(np.square(power)))
                freedoms.append(min(freedom, float(len(column))))
    if not energies:
        return 1.0
    pooled = np.sum(energies) ** 2 / np.sum(np.square(energies) / np.array(freedoms))
    return float(min(pooled / sum(one.size for one in residual), 1.0))


def chance_of_lines(residual: Sequence[FloatArray]) -> float:
    """Return how probable it is that noise has such lines in its spectrum in two trials, at most 1.

    The spectrum of a sensor's noise is smooth, whatever its colour; a vibration, a spring that pulsates, a motion that
    is not as simulated have lines. The second strongest trial counts: in one alone it may be a disturbance.
    """
    chances = sorted(_chance_of_largest_line(one) for one in residual)
    return min(len(chances) * chances[1], 1.0) if len(chances) > 1 else 1.0


def _chance_of_largest_line(residual: FloatArray) -> float:
    """Return how probable the largest power (n samples, m channels) is beside the median of those near it."""
    from scipy.ndimage import median_filter

    tapered = (residual - np.mean(residual, axis=0)) * np.hanning(len(residual))[:, None]
    power = np.square(np.abs(np.fft.rfft(tapered, axis=0)))[1 : (len(residual) + 1) // 2]
    near = median_filter(power, size=(criteria.LINES_NEAR, 1), mode="reflect")
    seen = power[criteria.SLOWEST_LINE :]
    if not seen.size or np.any(near <= 0.0):
        return 1.0
    # powers of noise are distributed exponentially, and half of them are below ln 2 of their mean
    largest = np.max(seen / near[criteria.SLOWEST_LINE :]) * np.log(2.0)
    return float(min(seen.size * np.exp(-largest), 1.0))


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
