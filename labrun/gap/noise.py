"""The noise floor: what repeats of a condition do not agree on, its size and its colour; else what is stated of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, FitTrial
from labrun.gap import criteria

_MOST_ORDER = 8
"""Highest order of the autoregressive predictor that makes noise white."""
_LEAST_INNOVATION = 1e-6
"""Part of the variance that is left when a higher order of the predictor would be fitting rounding."""
_MOST_STEPS = (80.0, 1.2816)
"""Percentile of the sizes of second differences that tells noise, and what it is of a normal variable."""
_FEWEST_WITNESS_SAMPLES = 16
"""Shorter trials say nothing of the noise of a sample."""


@dataclass(frozen=True)
class Predictor:
    """Best linear predictors of a stationary sequence of variance 1 from its 0, 1, ... p last values.

    Attributes
    ----------
    coefficients : p + 1 arrays of 0, 1, ... p numbers
        Of the value one back, two back ...
    deviation : (p + 1,)
        Standard deviation of what each leaves.
    """

    coefficients: tuple[FloatArray, ...]
    deviation: FloatArray

    @property
    def order(self) -> int:
        """How many last values it looks at."""
        return len(self.coefficients) - 1

    @cached_property
    def first(self) -> FloatArray:
        """What makes the first p values white, each from those before it, (p, p)."""
        matrix = np.eye(self.order)
        for k in range(self.order):
            matrix[k, :k] = -self.coefficients[k][::-1]
        return matrix / self.deviation[: self.order, None]


@dataclass(frozen=True)
class Whitener:
    """One predictor per channel."""

    predictors: tuple[Predictor, ...]

    def white(self, values: FloatArray) -> FloatArray:
        """Return (n, m) channels of standard deviation 1 as white noise of the same shape.

        The first samples, which have too short a past, are predicted from what there is (Levinson), so that nothing
        is lost or overweighted.
        """
        white = np.empty_like(values)
        for column, predictor in enumerate(self.predictors):
            p = predictor.order
            signal = values[:, column]
            if p == 0:
                white[:, column] = signal / predictor.deviation[0]
                continue
            numerator = np.concatenate([[1.0], -predictor.coefficients[p]])
            white[:, column] = np.convolve(signal, numerator)[: len(signal)] / predictor.deviation[p]
            first = min(p, len(signal))
            white[:first, column] = predictor.first[:first, :first] @ signal[:first]
        return white

    def coloured(self, white: FloatArray) -> FloatArray:
        """Return white noise (n, m) with the colour of the channels: what `white` undoes."""
        coloured = np.empty_like(white)
        from scipy.signal import lfilter, lfiltic

        for column, predictor in enumerate(self.predictors):
            p = predictor.order
            begin: list[float] = []
            for k in range(min(p, len(white))):
                past = np.array(begin[::-1])
                begin.append(
                    float(predictor.coefficients[k] @ past + predictor.deviation[k] * white[k, column])
                )
            coloured[: len(begin), column] = begin
            denominator = np.concatenate([[1.0], -predictor.coefficients[p]])
            if len(white) > p:
                driven = predictor.deviation[p] * white[p:, column]
                if p == 0:
                    coloured[:, column] = driven
                else:
                    state = lfiltic([1.0], denominator, np.array(begin[::-1]))
                    coloured[p:, column] = lfilter([1.0], denominator, driven, zi=state)[0]
        return coloured


def white(channels: int) -> Whitener:
    """Return the whitener of channels that are white already."""
    return Whitener(tuple(Predictor((np.empty(0),), np.ones(1)) for _ in range(channels)))


def fit_whitener(sequences: Sequence[FloatArray]) -> Whitener:
    """Fit predictors to sequences (n, m) that have standard deviation about 1, all of one colour per channel.

    Autocorrelations are pooled over the sequences; the order, at most 8, is the one with the least AICc.
    """
    channels = sequences[0].shape[1]
    return Whitener(
        tuple(_predictor([sequence[:, column] for sequence in sequences]) for column in range(channels))
    )


def _predictor(sequences: Sequence[FloatArray]) -> Predictor:
    longest = max(len(sequence) for sequence in sequences)
    total = sum(len(sequence) for sequence in sequences)
    most = max(0, min(_MOST_ORDER, longest // 10))
    covariance = np.array(
        [
            sum(float(sequence[lag:] @ sequence[: len(sequence) - lag]) for sequence in sequences) / total
            for lag in range(most + 1)
        ]
    )
    if covariance[0] <= 0.0:
        return Predictor((np.empty(0),), np.ones(1))
    coefficients, variance = _levinson(covariance / covariance[0])
    orders = np.arange(len(variance))
    criterion = total * np.log(variance) + 2.0 * (orders + 1) * total / np.maximum(total - orders - 2, 1)
    best = int(np.argmin(criterion))
    return Predictor(tuple(coefficients[: best + 1]), np.sqrt(variance[: best + 1]))


def _levinson(correlation: FloatArray) -> tuple[list[FloatArray], FloatArray]:
    """Return the predictors of order 0, 1 ... and the variance each leaves (Levinson 1946, Durbin 1960)."""
    coefficients: list[FloatArray] = [np.empty(0)]
    variance = [1.0]
    for order in range(1, len(correlation)):
        last = coefficients[-1]
        reflection = (correlation[order] - last @ correlation[1:order][::-1]) / variance[-1]
        next_variance = variance[-1] * (1.0 - reflection**2)
        if next_variance <= _LEAST_INNOVATION:
            break
        coefficients.append(np.concatenate([last - reflection * last[::-1], [reflection]]))
        variance.append(next_variance)
    return coefficients, np.array(variance)


Basis = Literal["repeats", "stated", "residual"]

_QUANTUM = 1.0 / np.sqrt(12.0)


@dataclass(frozen=True)
class Noise:
    """Noise of single trials, channel by channel.

    Attributes
    ----------
    sd : (m,)
        Standard deviation of one trial about what all repeats of its condition would agree on.
    whitener
        Turns noise of standard deviation 1 per channel into white noise.
    basis
        Whether repeats told it, the data state it as reading errors, or what is left of the best fit tells it.
    systematic : (m,)
        Variance that does not average out over repeats, in units of `sd` squared: the rounding of a sensor's steps,
        which every repeat suffers alike where its own noise is smaller than a step.
    deviations : per group, arrays (n, m)
        Of whole trials from their condition's mean, scaled to a single trial's size.
    freedom
        Number of independent deviations.
    energy_freedom
        Degrees of freedom of the energy of one trial's noise: large for noise of a sensor, about 1 where trials differ
        in one way only, as by a friction that changes.
    """

    sd: FloatArray
    whitener: Whitener
    basis: Basis
    systematic: FloatArray
    deviations: tuple[tuple[FloatArray, ...], ...]
    freedom: int
    energy_freedom: float = np.inf

    @property
    def known(self) -> bool:
        """Whether noise was told apart from gap by something else than what is left of a fit."""
        return self.basis != "residual"

    def floor(self, group: int) -> FloatArray:
        """Return the variance of one trial's own noise in a condition, in units of `sd` squared, (m,).

        Trials that scatter do so more where they move more: with enough repeats a condition has its own floor.
        """
        own = self.deviations[group]
        if len(own) < criteria.OWN_FLOOR_REPEATS:
            return 1.0 - self.systematic
        return np.asarray(
            np.mean([np.mean(np.square(residual / self.sd), axis=0) for residual in own], axis=0)
        )

    def mean_floor(self, group: int, count: int) -> FloatArray:
        """Return the variance of the mean of `count` trials of a condition, in units of `sd` squared, shape (m,)."""
        return np.asarray(self.floor(group) / count + self.systematic)

    def mean_sd(self, count: int) -> FloatArray:
        """Return the standard deviation of the mean of `count` trials, in units of `sd`, shape (m,)."""
        return np.asarray(np.sqrt((1.0 - self.systematic) / count + self.systematic))

    def white_mean(self, values: FloatArray, count: int) -> FloatArray:
        """Return the mean (n, m) of `count` trials, in units of `sd`, as white noise of standard deviation 1."""
        return np.asarray(self.whitener.white(values) / self.mean_sd(count))

    def plain(self) -> "Noise":
        """Return the same noise taken as white: where a large gap is mixed into it, its colour says nothing."""
        return replace(self, whitener=white(len(self.sd)))

    def draw(self, units: Dataset, rng: np.random.Generator, *, cautious: bool = False) -> list[FloatArray]:
        """Return noise of the mean of every unit, (n, m) each.

        The measured whole-trial deviations, recombined at random within their condition; drawn from the spectrum where
        there are too few of them.

        Parameters
        ----------
        cautious
            Let the energy scatter as widely as so few deviations allow: for parts of trials, where each is one of few.
        """
        return [self._draw_unit(unit, rng, cautious) for unit in units.trials]

    def _draw_unit(self, unit: FitTrial, rng: np.random.Generator, cautious: bool) -> FloatArray:
        shape = unit.outputs.shape
        own = self.deviations[unit.group] if self.freedom >= criteria.ENOUGH_FREEDOM else ()
        own = tuple(residual for residual in own if residual.shape == shape)
        rounding = rng.standard_normal(shape) * np.sqrt(self.systematic) * self.sd
        if len(own) < 2:
            size = self.sd * np.sqrt((1.0 - self.systematic) / unit.count)
            whole = self.whitener.coloured(rng.standard_normal(shape)) * size
            return np.asarray(whole + rounding)
        # deviations from a mean add up to zero: a random direction among their independent contrasts has the
        # covariance of one trial's noise, between samples and between channels, and its energy
        direction = rng.standard_normal(len(own))
        direction -= direction.mean()
        direction /= np.linalg.norm(direction)
        scale = np.sqrt((len(own) - 1.0) / len(own) / unit.count)
        freedom = min(self.energy_freedom, len(own) - 1.0) if cautious else self.energy_freedom
        if np.isfinite(freedom):
            scale *= np.sqrt(rng.chisquare(freedom) / freedom)
        return np.asarray(scale * np.tensordot(direction, np.stack(own), axes=1) + rounding)


def from_repeats(units: Dataset, residual: Sequence[Sequence[FloatArray]]) -> Noise | None:
    """Estimate the noise from what repeats do not agree on; None where there are no repeats.

    Parameters
    ----------
    residual : per unit, per member (n, m)
        Measured minus simulated of every trial: repeats whose inputs differ are compared after what the model says.
    """
    groups = len(units.conditions)
    deviations: list[tuple[FloatArray, ...]] = []
    freedom = 0
    for group in range(groups):
        trials = [trial_residual for index in units.of_group(group) for trial_residual in residual[index]]
        if len(trials) < 2:
            deviations.append(())
            continue
        length = min(len(trial) for trial in trials)
        mean = np.mean([trial[:length] for trial in trials], axis=0)
        scale = np.sqrt(len(trials) / (len(trials) - 1.0))
        deviations.append(tuple((trial[:length] - mean) * scale for trial in trials))
        freedom += len(trials) - 1
    if freedom == 0:
        return None
    every = [trial_residual for group in deviations for trial_residual in group]
    sd = np.sqrt(
        np.sum([np.sum(np.square(trial_residual), axis=0) for trial_residual in every], axis=0)
        / sum(map(len, every))
    )
    rounding = np.array([_common_rounding(*pair) for pair in zip(sd, quantum(units), strict=True)])
    sd = np.sqrt(np.square(sd) + rounding)
    whitener = fit_whitener([trial_residual / sd for trial_residual in every])
    energy = _energy_freedom(deviations, sd)
    return Noise(sd, whitener, "repeats", rounding / np.square(sd), tuple(deviations), freedom, energy)


def from_reading_errors(units: Dataset) -> Noise | None:
    """Return the noise that a recording states of its outputs; None where it does not.

    A reading is as uncertain in one row as in the next: white, and of one size in all trials.
    """
    stated = [output.reading_error for output in units.outputs]
    if not stated or any(reading_error is None for reading_error in stated):
        return None
    sd = np.array(stated, dtype=float)
    groups: tuple[tuple[FloatArray, ...], ...] = tuple(() for _ in units.conditions)
    return Noise(sd, white(len(sd)), "stated", np.zeros(len(sd)), groups, 0)


def _energy_freedom(deviations: Sequence[Sequence[FloatArray]], sd: FloatArray) -> float:
    """Return the degrees of freedom that the energies of independent deviations of one condition scatter like.

    The energy of noise with nu degrees of freedom has a relative variance of 2 / nu.
    """
    scatter, counted = 0.0, 0
    for group in deviations:
        if len(group) < criteria.OWN_FLOOR_REPEATS:
            continue
        stacked = np.stack([(residual / sd).ravel() for residual in group])
        count = len(group)
        helmert = np.array([_contrast(row, count) for row in range(1, count)])
        energies = np.sum(np.square(helmert @ stacked), axis=1)
        scatter += float(np.var(energies, ddof=1)) / float(np.mean(energies)) ** 2 * (count - 2)
        counted += count - 2
    if counted == 0:
        return np.inf
    return float(np.clip(2.0 / max(scatter / counted, 1e-9), 1.0, 1e6))


def _contrast(row: int, count: int) -> FloatArray:
    """Return one row of Helmert's orthonormal contrasts."""
    weights = np.zeros(count)
    weights[:row] = 1.0
    weights[row] = -float(row)
    return weights / np.linalg.norm(weights)


def _common_rounding(deviation: float, step: float) -> float:
    """Return the variance of the rounding error that all repeats of a condition share.

    Noise of standard deviation s before the rounding leaves the sum over k of
    (step / (pi k))^2 / 2 exp(-(2 pi k s / step)^2) in common (Widrow and Kollar, Quantization Noise, 2008, chapter 7);
    the rest of step^2 / 12 differs between repeats, and is part of the deviation that is seen.
    """
    from scipy.optimize import brentq

    orders = np.arange(1, 20)

    def common(noise: float) -> float:
        damped = np.exp(-4.0 * np.square(np.pi * orders * noise / step))
        return float(np.sum(np.square(step / (np.pi * orders)) / 2.0 * damped))

    def seen(noise: float) -> float:
        return noise**2 + common(0.0) - common(noise) - deviation**2

    if deviation >= step:
        return 0.0
    return common(float(brentq(seen, 0.0, 2.0 * step)))


def of_sensor(units: Dataset, residual: Sequence[FloatArray]) -> Noise:
    """Estimate what a sensor adds to each sample, from witnesses that know no repeats.

    The least of what an autoregressive predictor leaves of the residual, of what its second differences hold, and of
    the floor of its spectrum (median over ln 2); at least the rounding of the sensor's steps, and what no model is
    believed to. All of them take slow disturbances for gap: it is a lower bound of the noise.

    Parameters
    ----------
    residual : per unit (n, m)
        Of the recalibrated model.
    """
    spread = np.std(np.concatenate([unit.outputs for unit in units.trials]), axis=0)
    least = np.maximum(quantum(units) * _QUANTUM, criteria.MODEL_ROUNDING * spread)
    sd = [
        max(_sensor_sd([trial_residual[:, column] for trial_residual in residual]), size)
        for column, size in enumerate(least.tolist())
    ]
    groups: tuple[tuple[FloatArray, ...], ...] = tuple(() for _ in units.conditions)
    return Noise(np.array(sd), white(len(sd)), "residual", np.zeros(len(sd)), groups, 0)


def _sensor_sd(sequences: Sequence[FloatArray]) -> float:
    """Return the least of what several witnesses say of the noise of one channel, (n,) per trial."""
    size = float(np.sqrt(np.mean(np.square(np.concatenate(sequences)))))
    long = [sequence for sequence in sequences if len(sequence) >= _FEWEST_WITNESS_SAMPLES]
    if not long or size == 0.0:
        return size
    innovation = size * float(_predictor([sequence / size for sequence in long]).deviation[-1])
    # of most samples, not of all: where friction turns, a residual jumps, and that is no noise
    steps = np.abs(np.concatenate([np.diff(sequence, n=2) for sequence in long]))
    most, of_normal = _MOST_STEPS
    difference = float(np.percentile(steps, most)) / of_normal / np.sqrt(6.0)
    densities = np.concatenate(
        [np.square(np.abs(np.fft.rfft(sequence)[1:])) / len(sequence) for sequence in long]
    )
    spectrum = np.sqrt(float(np.median(densities)) / np.log(2.0))
    return float(min(size, innovation, difference, spectrum))


def from_residual(units: Dataset, residual: Sequence[Sequence[FloatArray]]) -> Noise:
    """Estimate the noise from what the best fit leaves, where nothing was repeated.

    A slow remainder of a wrong model counts as noise here: the estimate errs to the cautious side.
    """
    every = [trial_residual for unit in residual for trial_residual in unit]
    sd = np.sqrt(
        np.sum([np.sum(np.square(trial_residual), axis=0) for trial_residual in every], axis=0)
        / sum(map(len, every))
    )
    sd = np.maximum(sd, quantum(units) * _QUANTUM)
    groups: tuple[tuple[FloatArray, ...], ...] = tuple(() for _ in units.conditions)
    whitener = fit_whitener([trial_residual / sd for trial_residual in every])
    return Noise(sd, whitener, "residual", np.zeros_like(sd), groups, 0)


def quantum(units: Dataset) -> FloatArray:
    """Return the smallest step between different values of each output, the resolution of its sensor, shape (m,)."""
    steps = []
    for column in range(units.trials[0].outputs.shape[1]):
        values = np.concatenate([member[:, column] for unit in units.trials for member in unit.members])
        different = np.diff(np.unique(values))
        span = float(np.ptp(values))
        different = different[different > 1e-9 * max(span, 1e-300)]
        steps.append(
            float(different.min()) if different.size else max(1e-9 * float(np.max(np.abs(values))), 1e-300)
        )
    return np.array(steps)


def independent_share(residual: Sequence[FloatArray]) -> float:
    """Return how many independent numbers there are to each sample of residuals (n, m), by their spectra.

    White noise has one; a single sine two in a whole trial.
    """
    energies, freedoms = [], []
    for trial_residual in residual:
        for column in trial_residual.T:
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
    return float(min(pooled / sum(trial_residual.size for trial_residual in residual), 1.0))
