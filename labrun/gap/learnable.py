"""What any model could gain: the part of a residual that motion, inputs and their recent past predict at all.

Random neurons with a ridge regression on top (Huang, Zhu, Siew, Neurocomputing 70 (2006) 489) know no physics and
follow any dependence on what they are given. What they predict of a piece of time that they did not see is no noise;
what they cannot predict may still be a gap, of a kind that takes a longer memory.
"""

from collections.abc import Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, Problem
from labrun.gap import criteria
from labrun.gap.candidates import site_courses, typical_time_s
from labrun.gap.held_out import mean_residuals

_LEARNED_PIECES = 8
"""Pieces of every trial, one of which is withheld at a time."""
_MOST_LEARNED = 10000
"""Samples that are learned from."""
_MOST_NAMED = 2
"""Signals that the rest is said to depend on, at most."""
_NEURONS = 300
"""Random neurons of the regression."""
_LOOKED_AT = 3.0
"""Signals that each neuron sees, on average."""
_STEEPNESS = (0.3, 10.0)
"""Least and greatest steepness of a neuron."""
_RIDGES = (1e-4, 1e-3, 1e-2, 1e-1)
"""Strengths of the ridge per sample."""
_MEMORIES = (0.03, 0.125, 0.4)
"""Pasts that are seen, in typical periods of the outputs."""


def learnable_share(problem: Problem, z: FloatArray, *, conditions: bool = False) -> float:
    """Return the part of the squared residual that is predicted in pieces of time the regression did not see, 0 to 1.

    A piece of every trial is withheld at a time: the motion of a condition is known from its other pieces, and whether
    the residual goes with it is asked. Outputs count by their spread.

    Parameters
    ----------
    conditions
        Withhold whole conditions instead: whether what was learned holds where nothing was measured.
    """
    residual = [part / problem.spread for part in mean_residuals(problem, z)]
    signals = _signals(problem, z)
    if not signals:
        return 0.0
    seen = [
        _with_past(problem, trial, np.column_stack([parts[trial] for parts in signals.values()]))
        for trial in range(len(problem.data.trials))
    ]
    return _share(problem, residual, conditions, seen)


def dependence(problem: Problem, z: FloatArray, whole: float) -> tuple[str, ...]:
    """Return the signals that predict most of the residual by themselves, in words, the best first.

    Parameters
    ----------
    whole
        `learnable_share` with all signals.
    """
    residual = [part / problem.spread for part in mean_residuals(problem, z)]
    signals = _signals(problem, z)
    shares = {
        name: _share(
            problem, residual, False, [_with_past(problem, trial, part) for trial, part in enumerate(parts)]
        )
        for name, parts in signals.items()
    }
    best = sorted(shares, key=lambda name: -shares[name])[:_MOST_NAMED]
    return tuple(name for name in best if shares[name] >= criteria.MOST * whole)


def _share(
    problem: Problem, residual: Sequence[FloatArray], conditions: bool, seen: Sequence[FloatArray]
) -> float:
    """Return the part of a residual that signals `seen` predict where it was withheld, 0 to 1."""
    stride = max(1, sum(map(len, residual)) // _MOST_LEARNED)
    inside = np.concatenate([samples[::stride] for samples in seen])
    wanted = np.concatenate([samples[::stride] for samples in residual])
    group = np.concatenate([piece[::stride] for piece in _pieces(problem.data, conditions)])
    total = float(np.sum(np.square(wanted)))
    if total == 0.0:
        return 0.0
    squares = [
        np.sum(np.square(wanted - prediction)) for prediction in _predictions(_neurons(inside), wanted, group)
    ]
    return float(np.clip(1.0 - min(squares) / total, 0.0, 1.0))


def predictable_share(features: Sequence[FloatArray], values: Sequence[FloatArray]) -> float:
    """Return the share of squared values (n,) of each trial that its features (n, p) predict where withheld, 0 to 1.

    A piece of time of every trial is withheld at a time.
    """
    groups = [np.floor(_LEARNED_PIECES * np.arange(len(part)) / len(part)) for part in features]
    inside, wanted = np.concatenate(features), np.concatenate(values)[:, None]
    stride = max(1, len(wanted) // _MOST_LEARNED)
    inside, wanted, group = inside[::stride], wanted[::stride], np.concatenate(groups)[::stride]
    total = float(np.sum(np.square(wanted)))
    if total == 0.0 or not np.any(np.std(inside, axis=0) > 0.0):
        return 0.0
    squares = [np.sum(np.square(wanted - part)) for part in _predictions(_neurons(inside), wanted, group)]
    return float(np.clip(1.0 - min(squares) / total, 0.0, 1.0))


def _neurons(inside: FloatArray) -> FloatArray:
    """Return standardised signals (n, p), and neurons of several steepnesses that look at a few of them each."""
    rng = np.random.default_rng(0)
    size = np.std(inside, axis=0)
    signals = (inside - np.mean(inside, axis=0))[:, size > 0] / size[size > 0]
    weight = rng.standard_normal((signals.shape[1], _NEURONS))
    weight *= rng.random(weight.shape) < _LOOKED_AT / max(signals.shape[1], _LOOKED_AT)
    least, most = _STEEPNESS
    weight *= np.exp(rng.uniform(np.log(least), np.log(most), _NEURONS))
    threshold = rng.standard_normal(_NEURONS) * np.linalg.norm(weight, axis=0)
    return np.column_stack([np.ones(len(signals)), signals, np.tanh(signals @ weight + threshold)])


def _predictions(neurons: FloatArray, wanted: FloatArray, group: FloatArray) -> list[FloatArray]:
    """Return what is predicted of samples whose group was withheld, for several strengths of the ridge."""
    from scipy.linalg import solve

    groups, ridges = np.unique(group), np.array(_RIDGES) * len(wanted)
    predictions = [np.zeros_like(wanted) for _ in ridges]
    whole, answer, identity = neurons.T @ neurons, neurons.T @ wanted, np.eye(neurons.shape[1])
    for withheld in groups:
        test = group == withheld
        inside = neurons[test]
        normal, right = whole - inside.T @ inside, answer - inside.T @ wanted[test]
        for predicted, ridge in zip(predictions, ridges, strict=True):
            predicted[test] = inside @ solve(normal + ridge * identity, right, assume_a="pos")
    return predictions


def _pieces(data: Dataset, conditions: bool) -> list[FloatArray]:
    """Return the number of the piece of its trial, or of the condition, that every sample is in."""
    if conditions:
        return [np.full(len(trial.time_s), float(trial.group)) for trial in data.trials]
    count = _LEARNED_PIECES
    return [np.floor(count * np.arange(len(trial.time_s)) / len(trial.time_s)) for trial in data.trials]


def _signals(problem: Problem, z: FloatArray) -> dict[str, list[FloatArray]]:
    """Return what the regression may look at, by its name in words, each an array (n, features) per trial.

    Nothing where a motion follows what was measured: it follows its noise, too, and would predict that of it.
    """
    model = problem.model
    courses = None if any(output.followed for output in model.outputs) else site_courses(problem, z)
    if courses is None:
        return {}
    signals: dict[str, list[FloatArray]] = {}
    for index, site in enumerate(model.sites):
        for column, word in enumerate(("position", "speed", "load")):
            parts = [course[:, index, column : column + 1] for course, _ in courses]
            if any(np.ptp(part) > 0.0 for part in parts):
                signals[f"{word} of {site.name}"] = parts
    for column, output in enumerate(model.outputs):
        signals[output.name] = [outputs[:, column : column + 1] for _, outputs in courses]
    for column, signal in enumerate(model.inputs):
        signals[signal.name] = [trial.inputs[:, column : column + 1] for trial in problem.data.trials]
    return signals


def _with_past(problem: Problem, trial: int, signals: FloatArray) -> FloatArray:
    """Return signals (n, p) of a trial with their slopes and their recent past."""
    time_s, memory_s = problem.data.trials[trial].time_s, typical_time_s(problem)
    past = [_past(signals, time_s, memory_s * part) for part in _MEMORIES]
    return np.column_stack([signals, _slopes(signals, time_s), *past])


def _slopes(signals: FloatArray, time_s: FloatArray) -> FloatArray:
    if len(time_s) < 2:
        return np.zeros_like(signals)
    return np.asarray(np.gradient(signals, time_s, axis=0))


def _past(signals: FloatArray, time_s: FloatArray, ago_s: float) -> FloatArray:
    columns: Sequence[FloatArray] = [np.interp(time_s - ago_s, time_s, column) for column in signals.T]
    return np.column_stack(columns)
