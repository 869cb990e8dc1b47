"""Recalibrate the bare model, and tell how large a hidden effect has to be for the gap that is aimed at."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from .bench import Bench
from .plant import FloatArray, Kind, Measures, Plant, Programme
from .simulate import BlewUpError, fixed, march

_STEP = 1e-4
_HUGE = 1e3


@dataclass(frozen=True)
class Left:
    """What a recalibration leaves.

    Attributes
    ----------
    residual : (outputs, samples, trials)
        In the outputs' units.
    raw : (outputs, samples, trials)
        The same before, with the parameters as they are stated.
    """

    residual: FloatArray
    raw: FloatArray
    parameters: dict[str, float]


class Recalibration:
    """The bare model beside one programme of trials, as the person at the bench would calibrate it.

    Free are all parameters that are not known exactly, each held by its tolerance, and per trial the initial states
    that the model file calls "free", and the zero of each output where every trial has one of its own (`zeros`). All
    difference quotients run side by side in one simulation. `stated`: the parameters as the model file has them.
    """

    def __init__(
        self, plant: Plant, programme: Programme, stated: Mapping[str, float], *, zeros: bool = False
    ) -> None:
        self.plant = plant
        self.zeros = zeros
        self.programme = programme
        self.stated = dict(stated)
        self.free = [parameter for parameter in plant.parameters if parameter.tolerance != 0.0]
        self.starts = [
            row for row, state in enumerate(plant.states) if plant.initial[state] in ("free", "first")
        ]
        self.trials = len(programme.conditions)
        self.begin = plant.start(programme.conditions)
        self.columns = 1 + len(self.free) + len(self.starts)
        self._copies = programme.take(list(range(self.trials)) * self.columns)
        self._unit = np.maximum(np.max(np.abs(self.begin), axis=1, initial=0.0), 1e-2)

    def simulate(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return outputs (outputs, samples, trials) and derivatives (..., variables) at scaled variables z."""
        p, n = len(self.free), self.trials
        values = {
            parameter.name: np.full(self.columns * n, self.stated[parameter.name])
            for parameter in self.plant.parameters
        }
        start = np.tile(self.begin, self.columns)
        for index, free_parameter in enumerate(self.free):
            values[free_parameter.name] = values[free_parameter.name] * z[index]
            block = slice((1 + index) * n, (2 + index) * n)
            values[free_parameter.name][block] += _STEP * self.stated[free_parameter.name]
        for index, row in enumerate(self.starts):
            start[row] += np.tile(z[p + index * n : p + (index + 1) * n], self.columns) * self._unit[row]
            block = slice((1 + p + index) * n, (2 + p + index) * n)
            start[row][block] += _STEP * self._unit[row]
        y = fixed(Bench(self.plant, self._copies, values, start=start))
        base = y[:, :, :n]
        slopes = np.zeros((*base.shape, p + len(self.starts) * n))
        for index in range(p):
            slopes[..., index] = (y[:, :, (1 + index) * n : (2 + index) * n] - base) / _STEP
        for index in range(len(self.starts)):
            for trial in range(n):
                column = (1 + p + index) * n + trial
                slopes[:, :, trial, p + index * n + trial] = (y[:, :, column] - base[:, :, trial]) / _STEP
        return base, slopes

    def less_zeros(self, outputs: FloatArray) -> FloatArray:
        """Return outputs (outputs, samples, ...) without their means over each trial, where these tell nothing."""
        return outputs - np.mean(outputs, axis=1, keepdims=True) if self.zeros else outputs

    def run(self, measured: FloatArray, sd: FloatArray, rounds: int = 12) -> Left:
        """Calibrate on noise-free `measured`, weighed by the noise `sd` of each output."""
        weight = 1.0 / sd[:, None, None]
        p = len(self.free)
        tight = [
            index for index, free_parameter in enumerate(self.free) if free_parameter.tolerance != "free"
        ]
        tolerances = np.array([float(self.free[index].tolerance) for index in tight])
        count = p + len(self.starts) * self.trials
        cache: dict[bytes, tuple[FloatArray, FloatArray]] = {}

        def both(z: FloatArray) -> tuple[FloatArray, FloatArray]:
            key = z.tobytes()
            if key not in cache:
                cache.clear()
                try:
                    base, slopes = self.simulate(z)
                    residual = (self.less_zeros(base - measured) * weight).ravel()
                    jacobian = (self.less_zeros(slopes) * weight[..., None]).reshape(len(residual), count)
                except BlewUpError:
                    residual, jacobian = np.full(measured.size, _HUGE), np.zeros((measured.size, count))
                prior = np.zeros((len(tight), count))
                for line, index in enumerate(tight):
                    prior[line, index] = 1.0 / tolerances[line]
                pull = (z[tight] - 1.0) / tolerances
                cache[key] = np.concatenate([residual, pull]), np.concatenate([jacobian, prior])
            return cache[key]

        stated = np.concatenate([np.ones(p), np.zeros(count - p)])
        raw = both(stated)[0][: measured.size].reshape(measured.shape) / weight
        # a search from the stated values may end a whole swing away; from the truth it finds the right valley
        z0 = stated.copy()
        z0[:p] = [free_parameter.true / self.stated[free_parameter.name] for free_parameter in self.free]
        low = np.concatenate([np.full(p, 0.02), np.full(count - p, -50.0)])
        high = np.concatenate([np.full(p, 50.0), np.full(count - p, 50.0)])
        z = z0
        if count:

            def residuals(v: FloatArray) -> FloatArray:
                return both(v)[0]

            def slopes(v: FloatArray) -> FloatArray:
                return both(v)[1]

            fit = least_squares(
                residuals,
                z0,
                jac=slopes,
                bounds=(low, high),
                max_nfev=rounds,
                ftol=1e-7,
                xtol=1e-8,
                gtol=1e-10,
            )
            z = np.asarray(fit.x)
        residual = both(z)[0][: measured.size].reshape(measured.shape) / weight
        parameters = {
            free_parameter.name: float(self.stated[free_parameter.name] * z[index])
            for index, free_parameter in enumerate(self.free)
        }
        return Left(residual, raw, parameters)


def size_of(residual: FloatArray, sd: FloatArray) -> float:
    """Return G: root mean square over channels, samples and trials, in units of one trial's noise."""
    return float(np.sqrt(np.mean((residual / sd[:, None, None]) ** 2)))


def _peak(values: FloatArray) -> float:
    return float(max(np.quantile(np.abs(values), 0.995), 1e-9))


def _rms(values: FloatArray) -> float:
    return float(max(np.sqrt(np.mean(values**2)), 1e-12))


def measure(bench: Bench, outputs: FloatArray, kind: Kind, site: str) -> Measures:
    """Return the measures of a site, from a bench without anything hidden and its outputs."""
    plant, time_s = bench.plant, bench.time_s
    step_s, length_s = float(time_s[1] - time_s[0]), float(time_s[-1])
    if kind in ("joint", "body"):
        return _of_joint(bench, outputs, site, step_s, length_s)
    names = [signal.name for signal in (plant.inputs if kind == "input" else plant.outputs)]
    signals = bench.drive.inputs if kind == "input" else outputs
    row = names.index(site)
    q = _peak(signals[row])
    other = _peak(signals[(row + 1) % len(names)])
    period = _period(bench, outputs, step_s)
    fastest = min(_peak(np.diff(signals[row], axis=0) / step_s), 20.0 * np.pi * q / period)
    return Measures(
        q, fastest, 1.0, 1.0, 1.0, step_s, length_s, period, other, row, float(np.max(np.abs(signals[row])))
    )


def _period(bench: Bench, outputs: FloatArray, step_s: float) -> float:
    """Return the period in which a bench moves, from its sites where it has any motion of its own."""
    if bench.plant.states:
        return _of_joint(bench, outputs, bench.plant.sites[0].name, step_s, 1.0).period_s
    signal = bench.drive.inputs[0]
    spread, speed = _rms(signal - signal.mean(axis=0)), _rms(np.diff(signal, axis=0) / step_s)
    return float(np.clip(2 * np.pi * spread / speed, 0.2, 4.0))


def _of_joint(bench: Bench, outputs: FloatArray, site: str, step_s: float, length_s: float) -> Measures:
    plant = bench.plant
    row = plant.rate_row(site)
    states = march(bench, bench.initial()) if plant.states else {}
    q, v, a, load, stiffness, push = [], [], [], [], [], 1.0
    for t in bench.time_s[:: max(1, len(bench.time_s) // 400)]:
        x = states[round(float(t), 9)] if plant.states else np.zeros((0, bench.trials))
        u = bench.drive.at(float(t), float(t))
        at = plant.at(site, x, u, bench.p)
        q.append(at.coordinate)
        v.append(at.rate)
        load.append(at.load)
        stiffness.append(at.stiffness)
        if row is not None:
            without = plant.rates(x, u, bench.p, bench.zero)[row]
            pushed = plant.rates(x, u, bench.p, {**bench.zero, site: bench.zero[site] + 1.0})[row]
            a.append(without)
            push = float(np.mean(pushed - without))
    spread, speed = _rms(np.array(q) - np.mean(q, axis=0)), _rms(np.array(v))
    period = float(np.clip(2 * np.pi * spread / speed, 0.2, 4.0))
    peak = _peak(np.array(q))
    acceleration = _rms(np.array(a)) if a else _rms(np.array(v)) / period
    force = acceleration / push if a else _rms(outputs[0])
    own = float(np.mean(stiffness))
    return Measures(
        peak, _peak(np.array(v)), acceleration, force, own if own > 0 else force / spread,
        step_s, length_s, period, _peak(np.array(load)), top=float(np.max(np.abs(q))),
    )  # fmt: skip


_ROUNDS = 7
_CLOSE = 1.25
_REACHED = 0.6


class OutOfReachError(Exception):
    """No size gives the gap that is aimed at: recalibration swallows it, or the bench breaks first."""


class Projection:
    """What recalibration would leave of a small change of the outputs."""

    def __init__(
        self,
        plant: Plant,
        programme: Programme,
        truth: dict[str, float],
        sd: FloatArray,
        *,
        zeros: bool = False,
    ) -> None:
        bare = self._bare = Recalibration(plant, programme, truth, zeros=zeros)
        count = len(bare.free) + len(bare.starts) * bare.trials
        z = np.concatenate([np.ones(len(bare.free)), np.zeros(count - len(bare.free))])
        self.base, slopes = bare.simulate(z)
        slopes = bare.less_zeros(slopes)
        self.sd = sd
        self._jacobian = (slopes / sd[:, None, None, None]).reshape(self.base.size, count)
        prior = np.zeros(count)
        for index, free_parameter in enumerate(bare.free):
            if free_parameter.tolerance != "free":
                prior[index] = 1.0 / float(free_parameter.tolerance) ** 2
        normal = self._jacobian.T @ self._jacobian + np.diag(prior)
        self._inverse = np.linalg.pinv(normal, rcond=1e-13, hermitian=True) if count else np.zeros((0, 0))

    def signature(self, changed: FloatArray) -> FloatArray:
        """Return what is left, in units of the noise, of outputs that differ from the bare bench's; flat."""
        d = (self._bare.less_zeros(changed - self.base) / self.sd[:, None, None]).ravel()
        return np.asarray(d - self._jacobian @ (self._inverse @ (self._jacobian.T @ d)))

    def left(self, changed: FloatArray) -> float:
        """Return the gap that is left of outputs that differ from the bare bench's."""
        return float(np.sqrt(np.mean(self.signature(changed) ** 2)))

    def scatter(self, shares: FloatArray) -> FloatArray:
        """Return the standard deviation of each output when the free parameters scatter by these shares."""
        p = len(shares)
        moved = (self._jacobian[:, :p] * shares).reshape(*self.base.shape, p)
        return np.asarray(np.sqrt(np.mean(np.sum(moved**2, axis=-1), axis=(1, 2))) * self.sd)


def alike(first: FloatArray, second: FloatArray) -> float:
    """Return the cosine between two signatures."""
    return float(first @ second / np.sqrt((first @ first) * (second @ second)))


def sensor_factor(residual: FloatArray, sensor: FloatArray, scattered: FloatArray, aim: float) -> float:
    """Return the factor on the sensors' noise that makes a residual's gap the one aimed at, to four digits.

    Raises OutOfReachError: the noise would have to be more than 5 times smaller, or 4 times larger.
    """

    def gap(factor: float) -> float:
        return size_of(residual, np.sqrt((factor * sensor) ** 2 + scattered**2))

    low, high = 0.2, 4.0
    if not gap(high) <= aim <= gap(low):
        raise OutOfReachError
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if gap(middle) > aim else (low, middle)
    return float(f"{np.sqrt(low * high):.4g}")


def find_size(gap: Callable[[float], float], aim: float, start: float, most: float) -> float:
    """Return the size, to four digits, at which `gap` is near `aim`.

    Raises OutOfReachError: there is none up to `most`.
    """
    low, high = 0.0, most
    size, best, best_miss = min(start, most), 0.0, np.inf
    for _ in range(_ROUNDS):
        try:
            largest = gap(size)
        except BlewUpError:
            high, size = size, 0.5 * (low + size)
            continue
        miss = abs(np.log(max(largest, 1e-12) / aim))
        if miss < best_miss:
            best, best_miss = size, miss
        if miss < np.log(_CLOSE):
            break
        if largest < aim:
            low = size
        else:
            high = size
        if low >= most:
            break
        wanted = size * float(np.clip(aim / max(largest, 1e-12), 0.02, 50.0))
        size = (
            wanted
            if low < wanted < high
            else (most if wanted >= most and high >= most else 0.5 * (low + high))
        )
    if best_miss > -np.log(_REACHED):
        raise OutOfReachError
    return float(f"{best:.4g}")
