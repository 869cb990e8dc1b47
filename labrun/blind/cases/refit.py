"""Recalibrate the bare model on noise-free data, and tell what is left of a gap."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from .bench import Bench
from .plant import FloatArray, Plant, Programme
from .simulate import BlewUpError, fixed

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
    that the model file calls "free". All difference quotients run side by side in one simulation. `stated`: the
    parameters as the model file has them.
    """

    def __init__(self, plant: Plant, programme: Programme, stated: Mapping[str, float]) -> None:
        self.plant = plant
        self.programme = programme
        self.stated = dict(stated)
        self.free = [one for one in plant.parameters if one.tolerance != 0.0]
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
        values = {one.name: np.full(self.columns * n, self.stated[one.name]) for one in self.plant.parameters}
        start = np.tile(self.begin, self.columns)
        for index, one in enumerate(self.free):
            values[one.name] = values[one.name] * z[index]
            block = slice((1 + index) * n, (2 + index) * n)
            values[one.name][block] += _STEP * self.stated[one.name]
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

    def run(self, measured: FloatArray, sd: FloatArray, rounds: int = 12) -> Left:
        """Calibrate on noise-free `measured`, weighed by the noise `sd` of each output."""
        weight = 1.0 / sd[:, None, None]
        p = len(self.free)
        tight = [index for index, one in enumerate(self.free) if one.tolerance != "free"]
        tolerances = np.array([float(self.free[index].tolerance) for index in tight])
        count = p + len(self.starts) * self.trials
        cache: dict[bytes, tuple[FloatArray, FloatArray]] = {}

        def both(z: FloatArray) -> tuple[FloatArray, FloatArray]:
            key = z.tobytes()
            if key not in cache:
                cache.clear()
                try:
                    base, slopes = self.simulate(z)
                    residual = ((base - measured) * weight).ravel()
                    jacobian = (slopes * weight[..., None]).reshape(len(residual), count)
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
        z0[:p] = [one.true / self.stated[one.name] for one in self.free]
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
        found = {one.name: float(self.stated[one.name] * z[index]) for index, one in enumerate(self.free)}
        return Left(residual, raw, found)


def size_of(residual: FloatArray, sd: FloatArray) -> float:
    """Return G: root mean square over channels, samples and trials, in units of one trial's noise."""
    return float(np.sqrt(np.mean((residual / sd[:, None, None]) ** 2)))
