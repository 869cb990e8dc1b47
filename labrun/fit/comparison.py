"""Compare a prediction or another run with measurements, without fitting; the worst point comes first."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.experiment import condition_key, condition_text
from labrun.fit.dataset import Dataset
from labrun.fit.problem import Problem
from labrun.models import Model, simulate
from labrun.signals import Signal
from labrun.store import COMMAND, Run, TrialOutcome, imported_channels, is_recording

LEAST_SIZE = 0.05
"""A value below this share of its channel's greatest is held against that share: next to zero nothing is exact."""


@dataclass(frozen=True, slots=True)
class Pair:
    """One measured quantity and its prediction, of a trial or of the mean over a condition.

    Attributes
    ----------
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
    """The error of a prediction in one channel at one condition.

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
    size, floored
        What `relative` is over, and whether that is the least size of the channel, more than was measured here.
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
    size: float
    floored: bool


@dataclass(frozen=True, slots=True)
class Comparison:
    """Measured and predicted values, condition by condition.

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
        return len({condition_key(point.condition) for point in self.points})

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
            groups.setdefault(condition_key(pair.condition), []).append(pair)
        sizes = {
            key: _rms(np.concatenate([pair.measured for pair in group])) for key, group in groups.items()
        }
        least = LEAST_SIZE * max(sizes.values())
        points += [
            _point(group, max(sizes[key], least), floored=sizes[key] < least) for key, group in groups.items()
        ]
    return tuple(sorted(points, key=lambda point: -point.relative))


def _point(group: Sequence[Pair], size: float, *, floored: bool) -> ComparedPoint:
    first, differences = group[0], _differences(group)
    rmse = _rms(differences)
    both = [[getattr(pair, side) for pair in group] for side in ("measured", "predicted")]
    at_s = None
    if all(len(pair.time_s) == 1 for pair in group):
        measured, predicted = (float(np.mean([value[0] for value in values])) for values in both)
    else:
        index = int(np.argmax(np.abs(differences)))
        all_s = [pair.time_s for pair in group]
        measured, predicted, at_s = (float(np.concatenate(values)[index]) for values in (*both, all_s))
    relative = rmse / size if size > 0 else (np.inf if rmse > 0 else 0.0)
    trials = sum(pair.trials for pair in group)
    named = (first.condition, first.channel, first.unit, trials)
    return ComparedPoint(*named, measured, predicted, rmse, float(relative), at_s, size, floored)


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
    pairs = [
        Pair(trial.label, trial.condition, output.name, output.unit, trial.time_s, *sides)
        for trial, simulated in zip(data.trials, problem.simulated(problem.begin()), strict=True)
        for output, *sides in zip(data.outputs, trial.outputs.T, simulated.T, strict=True)
    ]
    free = [model.states[state] for state in problem.states.free]
    whole = [free[state] for state in problem.constant_states]
    first = [name for name in free if name not in whole]
    notes = []
    if first:
        notes.append(f"the start of {' and '.join(first)} was read from the first samples of each trial")
    if whole:
        names = " and ".join(whole)
        notes.append(
            f"{names}, which does not change in a trial, was read from the whole of it, each on its own"
        )
    return pairs, tuple(notes)


def _differences(pairs: Sequence[Pair]) -> FloatArray:
    return np.concatenate([pair.measured - pair.predicted for pair in pairs])


def _by_channel(pairs: Sequence[Pair]) -> dict[str, list[Pair]]:
    matched: dict[str, list[Pair]] = {}
    for pair in pairs:
        matched.setdefault(pair.channel, []).append(pair)
    return matched


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


Key = tuple[tuple[str, float | str], ...]


@dataclass(frozen=True)
class Side:
    """One side of a comparison: numbers and signals of a run or recording.

    Numbers are a run's objectives, or the outputs of a recording whose trials are rows of a table; signals are
    everything that was recorded over time.
    """

    run: Run
    name: str

    @cached_property
    def outcomes(self) -> list[TrialOutcome]:
        """Trials that were accepted."""
        return [outcome for outcome in self.run.outcomes if outcome.status == "done"]

    @cached_property
    def _recorded(self) -> bool:
        return is_recording(self.run.path) or bool(imported_channels(self.run.experiment_toml))

    @cached_property
    def _is_table(self) -> bool:
        return self._recorded and all(
            len(self.run.measured(outcome.index)["output"]) == 1 for outcome in self.outcomes
        )

    @cached_property
    def numbers(self) -> dict[str, str]:
        """Names and units of its numbers."""
        if self._is_table:
            return self._channels
        units = self.run.units()
        names = dict.fromkeys(name for outcome in self.outcomes for name in outcome.objectives)
        return {name: units.get(name, "1") for name in names}

    @cached_property
    def signals(self) -> dict[str, str]:
        """Names and units of its signals."""
        return {} if self._is_table else self._channels

    @cached_property
    def _channels(self) -> dict[str, str]:
        if self._recorded:
            return dict(self.run.devices.get("output", {}))
        return {
            f"{device}.{column}": unit
            for device, columns in self.run.devices.items()
            if device != COMMAND
            for column, unit in columns.items()
        }

    @cached_property
    def names(self) -> frozenset[str]:
        """Names that the conditions of all its trials have."""
        conditions = [set(outcome.condition) for outcome in self.outcomes]
        return frozenset(set.intersection(*conditions)) if conditions else frozenset()

    def by_condition(self, names: Iterable[str]) -> dict[Key, list[TrialOutcome]]:
        """Return the trials by the values of these names."""
        groups: dict[Key, list[TrialOutcome]] = {}
        wanted = sorted(names)
        for outcome in self.outcomes:
            groups.setdefault(tuple((name, _rounded(outcome.condition[name])) for name in wanted), []).append(
                outcome
            )
        return groups

    def number(self, name: str, outcomes: Sequence[TrialOutcome]) -> FloatArray:
        """Return one number of each trial that has it."""
        if self._is_table:
            return np.array([self.signal(name, outcome).values[0] for outcome in outcomes])
        objectives = [outcome.objectives[name] for outcome in outcomes if name in outcome.objectives]
        return np.array([value for value in objectives if np.isfinite(value)])

    def signal(self, name: str, outcome: TrialOutcome) -> Signal:
        """Return one signal of a trial, from its start to its end."""
        device, _, column = ("output", "", name) if self._recorded else name.partition(".")
        signal = self.run.measured(outcome.index)[device].signal(column)
        end_s = outcome.duration_s if outcome.duration_s > 0 else np.inf
        return signal if self._recorded else signal.between(-1e-3, end_s + 1e-3)

    @cached_property
    def units(self) -> dict[str, str]:
        """Names and units of its numbers and of its signals."""
        return {**self.numbers, **self.signals, **self.numbers}

    def signals_of(self, name: str, outcomes: Sequence[TrialOutcome]) -> list[Signal]:
        """Return one signal of each trial."""
        return [self.signal(name, outcome) for outcome in outcomes]


def told_apart(data: Run, other: Run) -> tuple[str, str]:
    """Return the names of two runs or recordings; those of the same experiment also by when they began."""
    if data.name != other.name:
        return data.name, other.name
    return f"{data.name} {data.identifier}", f"{other.name} {other.identifier}"


def paired(data: Run, other: Run) -> tuple[list[Pair], tuple[str, ...]]:
    """Return the quantities common to two runs or recordings, and remarks on those left out.

    Numbers of the same name are compared where there are any, else signals of the same name (``cameras.angle`` is the
    same as a recording's ``angle``), on the times of `data`. Conditions are the same if they agree in all names that
    both have; trials of one condition are averaged.

    Raises
    ------
    RequestError
        They have no quantity or no condition in common, or conditions that the other cannot tell apart.
    """
    mine, theirs = (Side(run, name) for run, name in zip((data, other), told_apart(data, other), strict=True))
    shared = _same_conditions(mine, theirs)
    numbers = [name for name in mine.numbers if name in theirs.numbers]
    matched = [(name, name) for name in numbers] or _same_signals(mine, theirs)
    if not matched:
        raise RequestError(
            f"{mine.name} and {theirs.name} have neither a number nor a signal of the same name",
            hint=f"{mine.name} has {', '.join(mine.units) or 'none'}; "
            f"{theirs.name} has {', '.join(theirs.units) or 'none'}",
        )
    own, others = mine.by_condition(shared), theirs.by_condition(shared)
    common = [key for key in own if key in others]
    if not common:
        raise RequestError(
            f"{mine.name} and {theirs.name} have no condition in common",
            hint="; ".join(
                f"{side.name} has {_some(keys)}" for side, keys in ((mine, own), (theirs, others))
            ),
        )
    notes = [
        f"{count} conditions are in {name} only" if count > 1 else f"one condition is in {name} only"
        for count, name in ((len(own) - len(common), mine.name), (len(others) - len(common), theirs.name))
        if count
    ]
    pairs = []
    for first, second in matched:
        units = mine.units[first], theirs.units[second]
        if units[0] != units[1] and "1" not in units:
            raise RequestError(
                f"{first} of {mine.name} is in {units[0]}, {second} of {theirs.name} in {units[1]}",
                hint="say the same unit in both, converting the numbers of one of them",
            )
        for key in common:
            comparison = (
                _numbers_beside(mine.number(first, own[key]), theirs.number(second, others[key]))
                if numbers
                else _signals_beside(mine.signals_of(first, own[key]), theirs.signals_of(second, others[key]))
            )
            if comparison is not None:
                condition = own[key][0].condition
                pairs.append(Pair(condition_text(condition), condition, first, units[0], *comparison))
    if not pairs:
        raise RequestError(f"{mine.name} and {theirs.name} have no accepted trial to compare")
    return pairs, tuple(notes)


def predicted_numbers(data: Run, model: Model) -> list[Pair] | None:
    """Return a model without states beside the objectives of a run; None if it predicts anything else."""
    side = Side(data, data.name)
    outputs = [output.name for output in model.outputs]
    if model.states or model.inputs or not all(name in side.numbers for name in outputs):
        return None
    pairs, at = [], np.zeros(1)
    for outcomes in side.by_condition(side.names).values():
        condition = outcomes[0].condition
        predicted = simulate(model, at, np.empty((1, 0)), condition=condition, substeps=1).outputs[0]
        for name, value in zip(outputs, predicted, strict=True):
            comparison = _numbers_beside(side.number(name, outcomes), np.array([value]))
            if comparison is not None:
                pairs.append(
                    Pair(condition_text(condition), condition, name, side.numbers[name], *comparison)
                )
    return pairs or None


_Beside = tuple[FloatArray, FloatArray, FloatArray, int]
"""Times, what was measured and what is held against it there, and of how many trials."""


def _same_conditions(mine: Side, theirs: Side) -> frozenset[str]:
    """Return the condition names common to both."""
    for side in (mine, theirs):
        if not side.outcomes:
            raise RequestError(f"{side.name} has no accepted trial", hint="labrun show tells why")
    shared = mine.names & theirs.names
    for side, other in ((mine, theirs), (theirs, mine)):
        for outcomes in side.by_condition(shared).values():
            differing = sorted(
                name
                for name in side.names - shared
                if len({_rounded(outcome.condition[name]) for outcome in outcomes}) > 1
            )
            if differing:
                raise RequestError(
                    f"conditions of {side.name} differ in {', '.join(differing)}, "
                    f"which {other.name} does not have",
                    hint="compare data whose conditions have the same names",
                )
    return shared


def _same_signals(mine: Side, theirs: Side) -> list[tuple[str, str]]:
    signals = []
    for name in mine.signals:
        last = name.rpartition(".")[2]
        alike = [signal for signal in theirs.signals if signal == name] or [
            signal
            for signal in theirs.signals
            if signal.rpartition(".")[2] == last and ("." not in name or "." not in signal)
        ]
        if len(alike) == 1:
            signals.append((name, alike[0]))
    return signals


def _numbers_beside(measured: FloatArray, held: FloatArray) -> _Beside | None:
    if not len(measured) or not len(held):
        return None
    return np.zeros(1), np.array([np.mean(measured)]), np.array([np.mean(held)]), len(measured)


def _signals_beside(measured: Sequence[Signal], held: Sequence[Signal]) -> _Beside | None:
    """Return the means of signals at those times of the first one at which all were recorded; None without any."""
    start_s = max(float(signal.time_s[0]) for signal in (*measured, *held))
    end_s = min(float(signal.time_s[-1]) for signal in (*measured, *held))
    time_s = measured[0].time_s
    time_s = time_s[(time_s >= start_s) & (time_s <= end_s)]
    if not len(time_s):
        return None
    here, there = (np.mean([signal.at(time_s) for signal in part], axis=0) for part in (measured, held))
    return time_s, here, there, len(measured)


_TOLD = 3


def _some(keys: Iterable[Key]) -> str:
    labels = [condition_text(dict(key)) or "one without names" for key in keys]
    return "; ".join(labels[:_TOLD]) + (f" and {len(labels) - _TOLD} more" if len(labels) > _TOLD else "")


def _rounded(value: float | str) -> float | str:
    """Return a value rounded so that formatting does not matter."""
    return value if isinstance(value, str) else float(f"{value:.9g}")
