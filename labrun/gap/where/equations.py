"""Which equation lacks a force: a white disturbance on each in turn, and the error of each output as their rival."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.effects import FORCED
from labrun.fit import Each, FitTrial, one_by_one
from labrun.gap import criteria
from labrun.gap.diagnosis import Place
from labrun.gap.where.difference import Difference
from labrun.gap.where.parts import plain
from labrun.gap.where.significance import redrawn
from labrun.models import simulate, site_course

_POINTS_TRIED = 3


def defined(difference: Difference) -> frozenset[int]:
    """Return the states whose derivative is another state, whatever states, inputs and forces are.

    The equations are asked at a few points that no relation between states favours; equal is equal to the last bit.
    """
    model = difference.model
    size, inputs, sites = len(model.states), len(model.inputs), len(model.sites)
    pointers = [ctypes.c_void_p] * 5
    derivative = ctypes.CFUNCTYPE(None, ctypes.c_double, *pointers)(model.derivative.address)
    p = model.vector(difference.parameters, difference.units.trials[0].condition)
    equal = ~np.eye(size, dtype=bool)
    for point in range(1, _POINTS_TRIED + 1):
        numbers = 0.3 * np.cos(point * np.sqrt(np.arange(2.0, 2.0 + size + inputs + sites)))
        x, u, force = np.split(numbers, [size, size + inputs])
        slope = np.full(size, np.nan)
        arrays = [np.ascontiguousarray(np.append(one, 0.0)) for one in (x, u, p, force)]
        derivative(0.1 * point, *[one.ctypes.data for one in arrays], slope.ctypes.data)
        equal &= slope[:, None] == x[None, :]
    return frozenset(np.flatnonzero(equal.any(axis=1)).tolist())


_STEP = 1e-5
"""Of the differences, in units of each state's range."""
_TAYLOR, _SQUARING = 8, 0.5
"""Order of the Taylor series of a matrix exponential, and the norm up to which it is taken directly."""


@dataclass(frozen=True)
class Linearised:
    """All units one after the other; the row of a unit's last sample has no next one and is never used.

    Attributes
    ----------
    dt_s : (n,)
    half, whole : (n, k, k)
        Transition over half an interval and over an interval.
    c : (n, m, k)
        Outputs, in units of one trial's noise, by states.
    begin : (n,)
        1 at the first sample of a unit.
    begin_sd : (k,)
        How well the state is known in which a unit begins.
    """

    dt_s: FloatArray
    half: FloatArray
    whole: FloatArray
    c: FloatArray
    begin: IntArray
    begin_sd: FloatArray


def linearised(difference: Difference) -> Linearised | None:
    """Return the linear system about the simulated trajectories; None where they, or it, are not finite."""
    parts = [_unit(difference, index) for index in range(len(difference.units.trials))]
    if any(part is None for part in parts):
        return None
    found = [part for part in parts if part is not None]
    columns = [np.concatenate([part[place] for part in found]) for place in range(4)]
    begin = np.concatenate([np.eye(1, len(part[0]), dtype=np.int64)[0] for part in found])
    if not all(np.all(np.isfinite(one)) for one in columns):
        return None
    rules = [difference.model.initial.get(state, "free") for state in difference.model.states]
    known = np.array(
        [
            criteria.BEGINS_AS_READ if rule in ("free", "first") else criteria.BEGINS_AS_STATED
            for rule in rules
        ]
    )
    reach = np.max([part[4] for part in found], axis=0)
    return Linearised(columns[0], columns[1], columns[2], columns[3], begin, known * reach)


def _unit(difference: Difference, index: int) -> tuple[FloatArray, ...] | None:
    from labrun.gap.where.compiled import linearise

    model, trial = difference.model, difference.units.trials[index]
    simulation = simulate(
        model,
        trial.time_s,
        difference.drives[index],
        parameters=difference.parameters,
        condition=trial.condition,
        initial_state=difference.initial[index],
        effects=difference.effects,
    )
    if not simulation.finite:
        return None
    drive = difference.drives[index]
    u = np.concatenate([drive.u[drive.grid.rows[:-1], 0], drive.u_last[None]])
    states = np.ascontiguousarray(simulation.states)
    reach = np.maximum(np.ptp(states, axis=0), np.abs(states).max(axis=0))
    steps = _STEP * np.where(reach > 0, reach, 1.0)
    a, c = linearise(
        trial.time_s, states, np.ascontiguousarray(u), model.vector(difference.parameters, trial.condition), steps,
        _forces(difference, trial, states, steps), model.derivative.address, model.output.address, len(model.outputs),
    )  # fmt: skip
    dt_s = np.diff(trial.time_s, append=trial.time_s[-1])
    half = _exponential(
        0.25 * dt_s[:, None, None] * (a + np.roll(a, -1, axis=0))
    )  # A is the mean of both ends
    return dt_s, half, half @ half, c / difference.noise_sd[:, None], reach


def _exponential(matrices: FloatArray) -> FloatArray:
    """Return the exponentials of matrices (n, k, k): a scaled and squared Taylor series, all scaled alike."""
    norm = matrices.shape[1] * float(np.max(np.abs(matrices), initial=0.0))
    squarings = int(np.clip(np.ceil(np.log2(max(norm / _SQUARING, 1.0))), 0, 60)) if np.isfinite(norm) else 0
    scaled = matrices / 2.0**squarings
    term = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    total = term.copy()
    for order in range(1, _TAYLOR + 1):
        term = term @ scaled / order
        total += term
    for _ in range(squarings):
        total = total @ total
    return total


def _forces(difference: Difference, trial: FitTrial, states: FloatArray, steps: FloatArray) -> FloatArray:
    """Return what effects at the sites do with each state a step ahead and a step behind, (2, k, n, sites).

    Their internal states are held at rest, and laws that depend on acceleration see none: an effect that is part of
    the model compared is small beside the model, and here only the way a disturbance spreads depends on it.
    """
    model = difference.model
    order = [site.name for site in model.sites]
    found = np.zeros((2, states.shape[1], len(states), len(order)))
    laws = [one for one in (*model.effects, *difference.effects) if one.effect.kind in FORCED]
    for side, k in product(range(2), range(states.shape[1]) if laws else ()):
        moved = states.copy()
        moved[:, k] += (1 - 2 * side) * steps[k]
        course = site_course(
            model,
            trial.time_s,
            moved,
            trial.inputs,
            parameters=difference.parameters,
            condition=trial.condition,
        )
        for one in laws:
            law, place = one.effect.function.python, order.index(one.site)
            rest, unused = np.zeros(one.effect.states + 1), np.zeros(one.effect.states + 1)
            found[side, k, :, place] += [
                law(t, q, rate, 0.0, load, stiffness, one.values, rest, unused)
                for t, (q, rate, load, stiffness) in zip(
                    trial.time_s.tolist(), course[:, place].tolist(), strict=True
                )
            ]
    return found


_MOST_NUMBERS = 400_000
"""Samples times redrawn noises that are filtered: more of them are told apart no better, and take long ..."""
_USUAL_STATES = 6
"""... the longer, the more states a model has beyond these."""
_SIZES = np.geomspace(1e-3, 1e13, 17)
_BETWEEN = (10**-0.5, 10**0.5)
"""Variance that a disturbance gives the outputs, in units of one trial's noise: the grid of its likelihood, refined
around its top. It reaches far up, since a drifting disturbance is large by the end of a trial."""
_OUTPUT_TIMES = (0.02, 0.5)
"""Correlation times of an output's error, in units of the trial."""


@dataclass(frozen=True)
class _Disturbed:
    """A linear system with one disturbance of intensity 1; arrays as in `labrun.gap.where.compiled.disturbed`."""

    at: str
    text: str
    phi: FloatArray
    q: FloatArray
    c: FloatArray
    start: FloatArray
    still: FloatArray

    def filtered(
        self, intensity: float, begin: IntArray, r: FloatArray, series: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return what a Kalman filter makes of series at an intensity."""
        from labrun.gap.where.compiled import disturbed

        return disturbed(self.phi, self.q, begin, self.c, r, self.start, self.still, intensity, series)


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
    if not 0 < size <= criteria.MOST_EQUATION_STATES or min(lengths) < criteria.FEWEST_EQUATION_SAMPLES:
        return []
    system = linearised(difference)
    if system is None:
        note(
            "The model cannot be linearised along its trajectories: which equation lacks a force is not told."
        )
        return []
    r = _measurement_variance(difference)
    told = difference.noise.known
    numbers = int(_MOST_NUMBERS * min(1.0, _USUAL_STATES / size))
    number = (
        min(draws, criteria.EQUATION_DRAWS[1], max(criteria.EQUATION_DRAWS[0], numbers // sum(lengths)))
        if told
        else 0
    )
    drawn = [np.concatenate(one) for one in redrawn(difference, rng, number)]
    series = np.stack(
        [np.concatenate([one / difference.noise_sd for one in difference.residual]), *drawn], axis=2
    )
    rivals = _rivals(difference, system)
    gains, kept = [], []
    *_, none = rivals[0][1][0].filtered(0.0, system.begin, r, series)
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
        max(1.0, float(np.mean(np.max(table[:, 1:], axis=0))))
        if number
        else max(1.0, criteria.GAIN_PER_NUMBER * r.size)
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
        if not difference.noise.known:
            jumps = np.diff(residual / difference.noise_sd, n=2, axis=0)
            variance = np.clip(np.mean(np.square(jumps), axis=0) / 6.0, criteria.SMOOTH_RESIDUAL**2, 1.0)
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


def _fit(one: _Disturbed, system: Linearised, r: FloatArray, series: FloatArray, none: FloatArray) -> _Fit:
    from labrun.gap.where.compiled import spread_of

    variance = spread_of(one.phi, one.q, system.begin, one.c, one.start)
    finite = variance[np.isfinite(variance)]
    size = float(np.median(finite)) if finite.size else 0.0
    best, intensity = np.zeros(series.shape[2]), 0.0
    if size <= 0.0:
        return _Fit(best, intensity)
    top = 0.0
    for round_ in (_SIZES / size, None):
        # the second round lies around the best of the first
        for wanted in round_ if round_ is not None else [top * factor for factor in _BETWEEN if top > 0]:
            _, variances, _, likelihood = one.filtered(float(wanted), system.begin, r, series)
            gain = np.where(np.isfinite(likelihood), likelihood - none, -np.inf)
            intensity = float(wanted) if gain[0] > best[0] else intensity
            best = np.maximum(best, gain)
            # a larger disturbance makes every variance larger, and what any series whatever could reach smaller
            if np.all(-0.5 * np.sum(np.log(variances)) <= none + best):
                break
        top = intensity
    return _Fit(best, intensity)


def _explained(
    one: _Disturbed, intensity: float, system: Linearised, r: FloatArray, series: FloatArray
) -> float:
    """Return the part of the excess over the noise that the smoothed disturbance explains."""
    from labrun.gap.where.compiled import left_over

    *filtered, _ = one.filtered(intensity, system.begin, r, series)
    after = left_over(one.phi, system.begin, one.c, r, *filtered)
    before = np.sum(np.square(series) / r[:, :, None], axis=(0, 1))
    redrawn_too = len(after) > 1
    floor_before, floor_after = (float(one[1:].mean()) if redrawn_too else 0.0 for one in (before, after))
    excess = float(before[0]) - floor_before
    if excess <= 0:
        return 0.0
    return float(np.clip(1.0 - (float(after[0]) - floor_after) / excess, 0.0, 1.0))
