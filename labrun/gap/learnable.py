"""What any model could gain: the part of a residual that motion, inputs and their recent past predict at all.

Random neurons with a ridge regression on top (Huang, Zhu, Siew, Neurocomputing 70 (2006) 489) know no physics and
follow any dependence on what they are given. What they predict of a piece of time that they did not see is no noise;
what they cannot predict may still be a gap, of a kind that takes a longer memory.
"""

from collections.abc import Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, OutputNoise, Problem
from labrun.gap import criteria
from labrun.gap.candidates import site_courses, typical_time_s
from labrun.gap.diagnosis import BeyondScatter
from labrun.gap.held_out import mean_residuals
from labrun.gap.noise import Noise
from labrun.gap.noise_threshold import chance_of_lines


def learnable_share(problem: Problem, z: FloatArray, *, conditions: bool = False) -> float:
    """Return the part of the squared residual that is predicted in pieces of time the regression did not see, 0 to 1.

    A piece of every trial is withheld at a time: the motion of a condition is known from its other pieces, and whether
    the residual goes with it is asked. Outputs count by their spread.

    Parameters
    ----------
    conditions
        Withhold whole conditions instead: whether what was learned holds where nothing was measured.
    """
    residual = [one / problem.spread for one in mean_residuals(problem, z)]
    return _share(problem, z, residual, conditions)


def beyond_scatter(problem: Problem, z: FloatArray, noise: Noise) -> BeyondScatter:
    """Return what is left once every trial may have parameters and initial states of its own.

    A parameter that is a little off in one trial goes with its motion, too, and is learned from its other pieces:
    repeats would show it to be noise. What every trial could make in this way is therefore taken out first.
    """
    residual = [one / problem.spread for one in mean_residuals(problem, z)]
    total = sum(float(np.sum(np.square(one))) for one in residual)
    if total == 0.0:
        return BeyondScatter()
    common = _without_own(problem, z, residual)
    left = sum(float(np.sum(np.square(one))) for one in common)
    units = [problem.spread / (noise.sd * noise.mean_sd(trial.count)) for trial in problem.data.trials]
    size = np.sqrt(np.mean(np.square(np.concatenate([a * b for a, b in zip(common, units, strict=True)]))))
    learnable = _share(problem, z, common, conditions=False) * left / total
    return BeyondScatter(learnable, float(size), chance_of_lines(common))


def _without_own(problem: Problem, z: FloatArray, residual: Sequence[FloatArray]) -> list[FloatArray]:
    """Return residuals in units of the outputs' spread without what parameters that scatter by trial would change."""
    from scipy.optimize import lsq_linear

    jacobian = problem.with_noise(OutputNoise(1.0 / problem.spread)).jacobian(z, central=False)
    most = criteria.SCATTER_BY_TRIAL * np.abs(z[: problem.size])
    found = []
    for one, shared, own in zip(residual, jacobian.shared, jacobian.own, strict=True):
        inside = shared[: one.size] * most
        seen = np.linalg.norm(inside, axis=0) > 0.0
        directions = np.column_stack([inside[:, seen], own[: one.size]])
        if directions.shape[1]:
            room = np.concatenate([np.ones(np.sum(seen)), np.full(own.shape[1], np.inf)])
            explained = lsq_linear(directions, one.ravel(), (-room, room)).x
            found.append(one - (directions @ explained).reshape(one.shape))
        else:
            found.append(one)
    return found


def _share(problem: Problem, z: FloatArray, residual: Sequence[FloatArray], conditions: bool) -> float:
    """Return the part of a residual that is predicted where it was withheld, 0 to 1."""
    seen = _seen(problem, z)
    if seen is None:
        return 0.0
    stride = max(1, sum(map(len, residual)) // criteria.MOST_LEARNED)
    inside = np.concatenate([one[::stride] for one in seen])
    wanted = np.concatenate([one[::stride] for one in residual])
    group = np.concatenate([one[::stride] for one in _pieces(problem.data, conditions)])
    total = float(np.sum(np.square(wanted)))
    if total == 0.0:
        return 0.0
    left = [np.sum(np.square(wanted - one)) for one in _predictions(_neurons(inside), wanted, group)]
    return float(np.clip(1.0 - min(left) / total, 0.0, 1.0))


def _neurons(inside: FloatArray) -> FloatArray:
    """Return standardised signals (n, p), and neurons of several steepnesses that look at a few of them each."""
    rng = np.random.default_rng(0)
    size = np.std(inside, axis=0)
    signals = (inside - np.mean(inside, axis=0))[:, size > 0] / size[size > 0]
    weight = rng.standard_normal((signals.shape[1], criteria.NEURONS))
    weight *= rng.random(weight.shape) < criteria.LOOKED_AT / max(signals.shape[1], criteria.LOOKED_AT)
    least, most = criteria.STEEPNESS
    weight *= np.exp(rng.uniform(np.log(least), np.log(most), criteria.NEURONS))
    threshold = rng.standard_normal(criteria.NEURONS) * np.linalg.norm(weight, axis=0)
    return np.column_stack([np.ones(len(signals)), signals, np.tanh(signals @ weight + threshold)])


def _predictions(neurons: FloatArray, wanted: FloatArray, group: FloatArray) -> list[FloatArray]:
    """Return what is predicted of samples whose group was withheld, for several strengths of the ridge."""
    from scipy.linalg import solve

    names, ridges = np.unique(group), np.array(criteria.RIDGES) * len(wanted)
    found = [np.zeros_like(wanted) for _ in ridges]
    whole, answer, one = neurons.T @ neurons, neurons.T @ wanted, np.eye(neurons.shape[1])
    for name in names:
        test = group == name
        inside = neurons[test]
        left, right = whole - inside.T @ inside, answer - inside.T @ wanted[test]
        for predicted, ridge in zip(found, ridges, strict=True):
            predicted[test] = inside @ solve(left + ridge * one, right, assume_a="pos")
    return found


def _pieces(data: Dataset, conditions: bool) -> list[FloatArray]:
    """Return the number of the piece of its trial, or of the condition, that every sample is in."""
    if conditions:
        return [np.full(len(one.time_s), float(one.group)) for one in data.trials]
    count = criteria.LEARNED_PIECES
    return [np.floor(count * np.arange(len(one.time_s)) / len(one.time_s)) for one in data.trials]


def _seen(problem: Problem, z: FloatArray) -> list[FloatArray] | None:
    """Return what the neurons see of every unit, (n, features): motion of the sites, outputs, inputs and their past."""
    if any(one.followed for one in problem.model.outputs):
        return None  # a motion that follows what was measured follows its noise, too, and would predict that of it
    courses = site_courses(problem, z)
    if courses is None:
        return None
    memory_s = typical_time_s(problem)
    found = []
    for trial, (course, outputs) in zip(problem.data.trials, courses, strict=True):
        flat = course[:, :, :3].reshape(len(course), -1)
        signals = np.column_stack([flat, outputs, trial.inputs])
        slopes = _slopes(signals, trial.time_s)
        past = [_past(signals, trial.time_s, memory_s * part) for part in criteria.MEMORIES]
        found.append(np.column_stack([signals, slopes, *past]))
    return found


def _slopes(signals: FloatArray, time_s: FloatArray) -> FloatArray:
    if len(time_s) < 2:
        return np.zeros_like(signals)
    return np.asarray(np.gradient(signals, time_s, axis=0))


def _past(signals: FloatArray, time_s: FloatArray, ago_s: float) -> FloatArray:
    columns: Sequence[FloatArray] = [np.interp(time_s - ago_s, time_s, one) for one in signals.T]
    return np.column_stack(columns)
