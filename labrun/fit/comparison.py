"""A prediction as it stands beside what was measured: nothing is fitted, the worst point comes first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.dataset import Dataset
from labrun.fit.problem import Problem
from labrun.models import Model

LEAST_SIZE = 0.05
"""A value below this share of its channel's greatest is held against that share: next to zero nothing is exact."""


@dataclass(frozen=True, slots=True)
class Pair:
    """One quantity of one trial, or of the mean of a condition's trials, and what is held against it.

    Attributes
    ----------
    label
        Names the trial.
    time_s, measured, predicted : (n,)
        A single number, as a row of a table, is a signal of one sample.
    trials
        How many `measured` is the mean of.
    """

    label: str
    condition: Mapping[str, float | str]
    channel: str
    unit: str
    time_s: FloatArray
    measured: FloatArray
    predicted: FloatArray
    trials: int = 1


@dataclass(frozen=True, slots=True)
class ComparedPoint:
    """How far a prediction is off in one channel under one condition.

    Attributes
    ----------
    measured, predicted
        The mean over trials of a single number; of a signal, both at `at_s`, where they differ most.
    rmse
        Root mean square of measured - predicted, over all samples of all trials.
    relative
        `rmse` over the root mean square of what was measured, see `LEAST_SIZE`; inf where only zero was measured.
    at_s
        None for a single number.
    """

    condition: Mapping[str, float | str]
    channel: str
    unit: str
    trials: int
    measured: float
    predicted: float
    rmse: float
    relative: float
    at_s: float | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """Measured beside predicted, condition by condition.

    Attributes
    ----------
    data, prediction
        Names of what was measured and of what is held against it.
    points
        The worst first.
    trials
        Of the data, that were compared.
    tolerance
        Greatest relative error that is accepted; None where nobody asked.
    notes
        Sentences: what was left out, and what was not predicted but read from the data.
    """

    data: str
    prediction: str
    pairs: tuple[Pair, ...]
    points: tuple[ComparedPoint, ...]
    trials: int
    tolerance: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def worst(self) -> ComparedPoint:
        """The point with the greatest relative error."""
        return self.points[0]

    @property
    def within(self) -> bool:
        """Tell whether no point is beyond the tolerance."""
        return self.tolerance is None or self.worst.relative <= self.tolerance

    @property
    def conditions(self) -> int:
        """How many conditions were compared."""
        return len({_key(point.condition) for point in self.points})

    def rmse(self) -> dict[str, float]:
        """Return the root mean square of measured - predicted of every channel, over all its samples."""
        return {channel: _rms(_differences(pairs)) for channel, pairs in _by_channel(self.pairs).items()}

    def distances(self) -> dict[str, float]:
        """Return the mean of |measured - predicted| of every channel, over all its samples."""
        return {
            channel: float(np.mean(np.abs(_differences(pairs))))
            for channel, pairs in _by_channel(self.pairs).items()
        }

    def units(self) -> dict[str, str]:
        """Return the unit of every channel."""
        return {pair.channel: pair.unit for pair in self.pairs}


def compared(pairs: Sequence[Pair]) -> tuple[ComparedPoint, ...]:
    """Return a point for each channel under each condition, the worst first."""
    points = []
    for own in _by_channel(pairs).values():
        groups: dict[object, list[Pair]] = {}
        for pair in own:
            groups.setdefault(_key(pair.condition), []).append(pair)
        sizes = {key: _rms(np.concatenate([one.measured for one in group])) for key, group in groups.items()}
        least = LEAST_SIZE * max(sizes.values())
        points += [_point(group, max(sizes[key], least)) for key, group in groups.items()]
    return tuple(sorted(points, key=lambda point: -point.relative))


def _point(group: Sequence[Pair], size: float) -> ComparedPoint:
    first, differences = group[0], _differences(group)
    rmse = _rms(differences)
    if all(len(pair.time_s) == 1 for pair in group):
        measured, predicted = (
            float(np.mean([getattr(pair, side)[0] for pair in group])) for side in ("measured", "predicted")
        )
        at_s = None
    else:
        place = int(np.argmax(np.abs(differences)))
        measured, predicted, at_s = (
            float(np.concatenate([getattr(pair, side) for pair in group])[place])
            for side in ("measured", "predicted", "time_s")
        )
    relative = rmse / size if size > 0 else (np.inf if rmse > 0 else 0.0)
    trials = sum(pair.trials for pair in group)
    return ComparedPoint(
        first.condition, first.channel, first.unit, trials, measured, predicted, rmse, float(relative), at_s
    )


def predictions(model: Model, data: Dataset) -> tuple[list[Pair], tuple[str, ...]]:
    """Simulate every trial with the parameters as the model states them.

    A state that the model lets begin "free" is taken from the first samples of the trial, or from the whole of it if it
    never changes: it belongs to the trial, and the second result says so.

    Raises
    ------
    FitError
        The model leaves the finite numbers.
    """
    problem = Problem.of(model, data)
    simulated = problem.simulated(problem.begin())
    pairs = [
        Pair(
            trial.label,
            trial.condition,
            output.name,
            output.unit,
            trial.time_s,
            trial.outputs[:, column],
            outputs[:, column],
        )
        for trial, outputs in zip(data.trials, simulated, strict=True)
        for column, output in enumerate(data.outputs)
    ]
    constant = problem.constant_states
    free = [model.states[state] for state in problem.states.free]
    first = [name for place, name in enumerate(free) if place not in constant]
    whole = [name for place, name in enumerate(free) if place in constant]
    notes = (
        f"the start of {' and '.join(first)} was read from the first samples of each trial" if first else "",
        f"{' and '.join(whole)}, which does not change in a trial, was read from the whole of it, each on its own"
        if whole
        else "",
    )
    return pairs, tuple(filter(None, notes))


def _differences(pairs: Sequence[Pair]) -> FloatArray:
    return np.concatenate([pair.measured - pair.predicted for pair in pairs])


def _by_channel(pairs: Sequence[Pair]) -> dict[str, list[Pair]]:
    found: dict[str, list[Pair]] = {}
    for pair in pairs:
        found.setdefault(pair.channel, []).append(pair)
    return found


def _key(condition: Mapping[str, float | str]) -> tuple[tuple[str, float | str], ...]:
    return tuple(sorted(condition.items()))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
