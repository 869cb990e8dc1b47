"""Which equation lacks a force: a white disturbance on each in turn, and the error of each output as their rival."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.fit.workers import Each, one_by_one
from labrun.gap.diagnosis import Place
from labrun.gap.where.difference import Difference
from labrun.gap.where.kinematics import defined
from labrun.gap.where.linearised import Linearised, linearised
from labrun.gap.where.significance import redrawn
from labrun.gap.where.wording import plain

FloatArray = NDArray[np.float64]

_MOST_DRAWS = 60
_FEWEST_DRAWS = 19
_MOST_NUMBERS = 400_000
"""Samples times redrawn noises that are filtered: more of them are told apart no better, and take long ..."""
_USUAL_STATES = 6
"""... the longer, the more states a model has beyond these."""
_SIZES = np.geomspace(1e-3, 1e13, 17)
_BETWEEN = (10**-0.5, 10**0.5)
"""Variance that a disturbance gives the outputs, in units of one trial's noise: the grid of its likelihood, refined
around its top. It reaches far up, since a drifting disturbance is large by the end of a trial."""
_PER_NUMBER = 0.005
"""Gain per measured number by which rivals must differ to be told apart where noise is not known by repeats."""
_OUTPUT_TIMES = (0.02, 0.5)
"""Correlation times of an output's error, in units of the trial."""
_SMOOTH = 0.05
"""Of a residual that hardly changes from sample to sample: no model is right to less of it."""
_FEWEST_SAMPLES = 32
_MOST_STATES = 12


@dataclass(frozen=True)
class _Disturbed:
    """A linear system with one disturbance of intensity 1; arrays as in `labrun.gap.where.kalman.disturbed`."""

    at: str
    text: str
    phi: FloatArray
    q: FloatArray
    c: FloatArray
    start: FloatArray
    still: FloatArray


@dataclass(frozen=True)
class _Fit:
    """Gain in log-likelihood of each series over no disturbance, and the intensity the first asks for."""

    gain: FloatArray
    intensity: float


def equation_places(
    difference: Difference,
    rng: np.random.Generator,
    *,
    draws: int,
    quiet: bool,
    note: Callable[[str], None],
    each: Each = one_by_one,
) -> list[Place]:
    """Return one place per state equation, and one per output, that a random disturbance may act on.

    An equation that only says which state is the rate of which lacks nothing, and is left out.

    The model is linearised along its recalibrated trajectories, and the residual filtered by a Kalman filter with
    white noise of unknown intensity on one equation at a time; the likelihood says where it is needed (Kristensen,
    Madsen and Jorgensen, Automatica 40 (2004) 225, the idea of CTSM). An error of the output itself, autocorrelated,
    is the rival of the same size. What noise alone gains that way is taken off each. Each one's share is the part of
    the excess that its smoothed disturbance explains, times its weight among them all: the exponential of its gain,
    tempered by the gain that noise alone reaches, because the noise is not quite white. p is the part of redrawn,
    recalibrated noises whose largest gain is as large.

    None for models without states, or of more than 12, and for trials of fewer than 32 samples.
    """
    size, lengths = len(difference.model.states), [len(one) for one in difference.residual]
    if not 0 < size <= _MOST_STATES or min(lengths) < _FEWEST_SAMPLES:
        return []
    system = linearised(difference)
    if system is None:
        note(
            "The model cannot be linearised along its trajectories: which equation lacks a force is not told."
        )
        return []
    r = _measurement_variance(difference)
    told = difference.noise.basis == "repeats"
    numbers = int(_MOST_NUMBERS * min(1.0, _USUAL_STATES / size))
    number = min(draws, _MOST_DRAWS, max(_FEWEST_DRAWS, numbers // sum(lengths))) if told else 0
    drawn = [np.concatenate(one) for one in redrawn(difference, rng, number)]
    series = np.stack(
        [np.concatenate([one / difference.noise_sd for one in difference.residual]), *drawn], axis=2
    )
    rivals = _rivals(difference, system)
    gains, kept = [], []
    none = _undisturbed(rivals[0][1][0], system, r, series)
    everything = each(
        lambda one: _fit(one, system, r, series, none), [one for _, several in rivals for one in several]
    )
    for _, several in rivals:
        fits, everything = everything[: len(several)], everything[len(several) :]
        best = max(range(len(fits)), key=lambda place: fits[place].gain[0])
        gains.append(np.max([fit.gain for fit in fits], axis=0))
        kept.append((several[best], fits[best].intensity))
    table = np.stack(gains)
    usual = table[:, 1:].mean(axis=1) if number else np.zeros(len(table))
    adjusted = table - usual[:, None]
    tempering = (
        max(1.0, float(np.mean(np.max(table[:, 1:], axis=0)))) if number else max(1.0, _PER_NUMBER * r.size)
    )
    weight = np.exp((adjusted[:, 0] - adjusted[:, 0].max()) / tempering)
    weight /= weight.sum()
    largest = np.max(adjusted[:, 1:], axis=0) if number else np.empty(0)
    found = []
    for row, (one, intensity) in enumerate(kept):
        share = 0.0 if quiet else float(weight[row]) * _explained(one, intensity, system, r, series)
        p = float(1 + np.sum(largest >= adjusted[row, 0])) / (number + 1) if number else None
        found.append(Place("equation", one.at, share, p, one.text))
    return found


def _measurement_variance(difference: Difference) -> FloatArray:
    """Return the variance of every unit's mean about the truth, in units of one trial's noise, shape (n, m).

    Where repeats do not tell the noise, what changes from sample to sample does.
    """
    parts = []
    for unit, residual in zip(difference.units.trials, difference.residual, strict=True):
        variance = np.full(residual.shape[1], 1.0 / unit.count)
        if difference.noise.basis == "residual":
            jumps = np.diff(residual / difference.noise_sd, n=2, axis=0)
            variance = np.clip(np.mean(np.square(jumps), axis=0) / 6.0, _SMOOTH**2, 1.0)
        parts.append(np.broadcast_to(variance, residual.shape))
    return np.ascontiguousarray(np.concatenate(parts))


def _rivals(difference: Difference, system: Linearised) -> list[tuple[str, list[_Disturbed]]]:
    model, size = difference.model, len(difference.model.states)
    still = np.diag(np.square(system.begin_sd))
    found = []
    by_definition = defined(difference)
    for state, name in enumerate(model.states):
        if state in by_definition:
            continue
        ends = [np.broadcast_to(np.eye(size)[state], system.c.shape[::2]), system.half[:, :, state]]
        ends.append(system.whole[:, :, state])
        products = [one[:, :, None] * one[:, None, :] for one in ends]
        q = system.dt_s[:, None, None] / 6.0 * (products[0] + 4.0 * products[1] + products[2])
        text = f"the equation of {plain(name)}"
        one = _Disturbed(name, text, system.whole, q, system.c, np.zeros((size, size)), still)
        found.append((name, [one]))
    duration = float(np.median([trial.time_s[-1] - trial.time_s[0] for trial in difference.units.trials]))
    for column, output in enumerate(model.outputs):
        several = [_output_error(system, column, output.name, part * duration) for part in _OUTPUT_TIMES]
        found.append((output.name, several))
    return found


def _output_error(system: Linearised, column: int, name: str, correlation_s: float) -> _Disturbed:
    """Return the system with nothing disturbed but an Ornstein-Uhlenbeck process that is added to one output."""
    count, channels, size = system.c.shape
    kept, stationary = np.exp(-system.dt_s / correlation_s), 0.5 * correlation_s
    phi, q = np.zeros((count, size + 1, size + 1)), np.zeros((count, size + 1, size + 1))
    phi[:, :size, :size], phi[:, size, size] = system.whole, kept
    q[:, size, size] = stationary * (1.0 - kept**2)
    c, start, still = (
        np.zeros((count, channels, size + 1)),
        np.zeros((size + 1, size + 1)),
        np.zeros(size + 1),
    )
    c[:, :, :size], c[:, column, size] = system.c, 1.0
    start[size, size], still[:size] = stationary, np.square(system.begin_sd)
    return _Disturbed(
        f"{name} (output)", f"the output {plain(name)} itself", phi, q, c, start, np.diag(still)
    )


def _undisturbed(one: _Disturbed, system: Linearised, r: FloatArray, series: FloatArray) -> FloatArray:
    """Return the log-likelihood of each series without any disturbance, whichever it would be."""
    return _filtered(one, 0.0, system, r, series)[0]


def _filtered(
    one: _Disturbed, intensity: float, system: Linearised, r: FloatArray, series: FloatArray
) -> tuple[FloatArray, float]:
    """Return the log-likelihood of each series, and the most that any series whatever could have."""
    from labrun.gap.where.kalman import disturbed

    gains = np.empty((*r.shape, one.c.shape[2]))
    variances, innovations, likelihood = np.empty(r.shape), np.empty(series.shape), np.empty(series.shape[2])
    disturbed(
        one.phi, one.q, system.begin, one.c, r, one.start, one.still, intensity, series,
        gains, variances, innovations, likelihood,
    )  # fmt: skip
    return likelihood, -0.5 * float(np.sum(np.log(variances)))


def _fit(one: _Disturbed, system: Linearised, r: FloatArray, series: FloatArray, none: FloatArray) -> _Fit:
    from labrun.gap.where.kalman import spread_of

    variance = np.empty(len(r))
    spread_of(one.phi, one.q, system.begin, one.c, one.start, variance)
    finite = variance[np.isfinite(variance)]
    size = float(np.median(finite)) if finite.size else 0.0
    best, intensity = np.zeros(series.shape[2]), 0.0
    if size <= 0.0:
        return _Fit(best, intensity)
    top = 0.0
    for round_ in (_SIZES / size, None):
        # the second round lies around the best of the first
        for wanted in round_ if round_ is not None else [top * factor for factor in _BETWEEN if top > 0]:
            likelihood, most = _filtered(one, float(wanted), system, r, series)
            gain = np.where(np.isfinite(likelihood), likelihood - none, -np.inf)
            intensity = float(wanted) if gain[0] > best[0] else intensity
            best = np.maximum(best, gain)
            # a larger disturbance makes every variance larger, and what any series could reach smaller
            if np.all(most <= none + best):
                break
        top = intensity
    return _Fit(best, intensity)


def _explained(
    one: _Disturbed, intensity: float, system: Linearised, r: FloatArray, series: FloatArray
) -> float:
    """Return the part of the excess over the noise that the smoothed disturbance explains."""
    from labrun.gap.where.kalman import disturbed, left_over

    many = series.shape[2]
    gains, variances = np.empty((*r.shape, one.c.shape[2])), np.empty(r.shape)
    innovations, likelihood, after = np.empty(series.shape), np.empty(many), np.empty(many)
    disturbed(
        one.phi, one.q, system.begin, one.c, r, one.start, one.still, intensity, series,
        gains, variances, innovations, likelihood,
    )  # fmt: skip
    left_over(one.phi, system.begin, one.c, r, gains, variances, innovations, after)
    before = np.sum(np.square(series) / r[:, :, None], axis=(0, 1))
    floor_before, floor_after = (
        (float(before[1:].mean()), float(after[1:].mean())) if many > 1 else (0.0, 0.0)
    )
    excess = float(before[0]) - floor_before
    if excess <= 0:
        return 0.0
    return float(np.clip(1.0 - (float(after[0]) - floor_after) / excess, 0.0, 1.0))
