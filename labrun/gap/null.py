"""What chance alone would explain: noise from repeats, or the residual itself without its tie to the motion.

Where conditions were repeated, noise of whole trials is drawn again. Where nothing was, a surrogate of the residual
stands for it: its spectrum in every trial with phases drawn at random (Theiler et al., Physica D 58 (1992) 77). A
candidate is believed if it explains more of the residual than the best of all candidates does of such surrogates,
whatever the size of the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Problem
from labrun.gap import criteria
from labrun.gap.noise import Noise
from labrun.gap.screening import Base

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
    """Return a base's residual with the spectrum of every trial and phases drawn at random, one set for all outputs."""
    found = []
    for trial, residual in zip(base.problem.data.trials, base.residual, strict=True):
        samples, channels = trial.outputs.shape
        spectrum = np.fft.rfft(residual[: samples * channels].reshape(samples, channels), axis=0)
        turned = np.exp(2j * np.pi * rng.random(len(spectrum)))
        turned[0] = rng.choice([-1.0, 1.0])
        if samples % 2 == 0:
            turned[-1] = rng.choice([-1.0, 1.0])
        drawn = np.fft.irfft(spectrum * turned[:, None], n=samples, axis=0).ravel()
        found.append(np.concatenate([drawn, np.zeros(len(residual) - len(drawn))]))
    return found


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
