"""Trials that could be made, and how each would begin."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.dataset import Dataset, FitTrial
from labrun.gap.next.rivals import Rival


@dataclass(frozen=True)
class PlannedTrial:
    """One trial that the rig could make.

    Attributes
    ----------
    time_s : (n,)
        When outputs would be sampled.
    inputs : (n, k)
        What would drive the model, in its order.
    cost_s
        Rig time of all its repeats, moves, settling and resets included as far as they are known.
    like
        FitTrial of the data whose beginning it takes over, and a factor on it; None where the condition tells.
    reach
        How far it goes beyond what was measured, as a factor: the farther, the less any model is to be believed.
    """

    label: str
    condition: Mapping[str, float | str]
    time_s: FloatArray
    inputs: FloatArray
    cost_s: float
    like: tuple[int, float] | None = None
    reach: float = 1.0


def beginnings(rival: Rival, trials: Sequence[PlannedTrial]) -> FloatArray:
    """Return the scaled free initial states that new trials would have, shape (trials, states).

    Where a trial begins depends on its condition: a body that is let go at an angle begins there. The dependence is
    taken from the states that were fitted to the measured trials, linear in the conditions.
    """
    own = rival.own
    if own.shape[1] == 0:
        return np.empty((len(trials), 0))
    measured = [unit.condition for unit in rival.problem.data.trials]
    names = _numbers(measured)
    known = _features(measured, names)
    coefficients = np.linalg.lstsq(known, own, rcond=1e-9)[0]
    predicted = _features([trial.condition for trial in trials], names, measured) @ coefficients
    for index, trial in enumerate(trials):
        if trial.like is not None:
            unit, factor = trial.like
            predicted[index] = own[unit] * factor
    return np.asarray(predicted)


def planned_data(
    dataset: Dataset, trials: Sequence[PlannedTrial], outputs: Sequence[FloatArray], repeats: int
) -> Dataset:
    """Return new trials as averaged data, had they come out as `outputs` in every repeat."""
    made = tuple(
        FitTrial(
            trial.label,
            trial.condition,
            1,
            trial.time_s,
            trial.inputs,
            one,
            group=group,
            members=(one,) * repeats,
        )
        for group, (trial, one) in enumerate(zip(trials, outputs, strict=True))
    )
    return replace(dataset, trials=made, conditions=tuple(trial.label for trial in trials))


def joined(one: Dataset, other: Dataset) -> Dataset:
    """Return the trials of both, conditions of the second counted on."""
    shift = len(one.conditions)
    trials = (*one.trials, *(replace(trial, group=trial.group + shift) for trial in other.trials))
    return replace(one, trials=trials, conditions=(*one.conditions, *other.conditions))


def _numbers(conditions: Sequence[Mapping[str, float | str]]) -> list[str]:
    """Return the names of the numbers that differ between conditions; all numbers if only one was measured."""
    first = conditions[0]
    names = [
        name
        for name in first
        if all(
            isinstance(one.get(name), float | int) and not isinstance(one[name], bool) for one in conditions
        )
    ]
    varying = [name for name in names if len({one[name] for one in conditions}) > 1]
    return varying or names


def _features(
    conditions: Sequence[Mapping[str, float | str]],
    names: Sequence[str],
    measured: Sequence[Mapping[str, float | str]] | None = None,
) -> FloatArray:
    """Return the numbers of the conditions, and a constant where enough different ones were measured to tell it."""
    known = conditions if measured is None else measured
    different = {tuple(one[name] for name in names) for one in known}
    columns = [np.array([float(one.get(name, 0.0)) for one in conditions]) for name in names]
    if len(different) > len(names) + 1 or not names:
        columns.append(np.ones(len(conditions)))
    return np.column_stack(columns)
