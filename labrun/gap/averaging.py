"""Repeats that one simulation predicts, averaged: what the diagnosis takes as its trials."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RecordingError
from labrun.experiment import condition_key, condition_text, only, varying
from labrun.fit import FIRST_SAMPLES, Dataset, FitTrial
from labrun.gap import criteria
from labrun.models import Model

_FEWEST_ALIGNED_SAMPLES = 8
"""Shorter repeats are not carried over to one time base, and say nothing about how they begin."""
_MOST_CONDITIONS = 8
"""Conditions that a model with states is held against, where enough of them were repeated to tell the noise."""
_SAMPLES_APART = 2
"""Repeats whose numbers of samples differ by more did not take the same course."""
_SHARE_APART = 1e-3
"""In long trials a sensor's own clock and its gaps make a difference of this share, too."""
_SAME_INPUT = 0.01
"""Inputs that differ by less than this part of their spread are one command, read at other times."""


def averaged(dataset: Dataset, model: Model) -> Dataset:
    """Group the trials by condition and average repeats that are predicted by one simulation.

    Trials stay apart where they differ by more than noise: in their inputs, their time base or their free initial
    states.

    Raises
    ------
    RecordingError
        A trial too short to say anything, or numbers that are not finite.
    """
    groups: dict[object, list[FitTrial]] = {}
    for trial in dataset.trials:
        _check(trial, dataset)
        groups.setdefault(condition_key(trial.condition), []).append(trial)
    rules = {model.initial.get(state, "free") for state in model.states}
    free, read = "free" in rules, "first" in rules
    averages: list[FitTrial] = []
    for group, trials in enumerate(groups.values()):
        alike = None if free or len(trials) == 1 else _on_one_time_base(trials)
        # where nothing is read from the first samples, one simulation predicts all, however each begins
        if alike is not None and (not read or _same_beginning(alike)):
            averages.append(_mean(alike, group))
        else:
            averages.extend(replace(trial, group=group, members=(trial.outputs,)) for trial in trials)
    names = varying(trial.condition for trial in dataset.trials)
    labels = [
        condition_text(only(trials[0].condition, names)) or trials[0].label for trials in groups.values()
    ]
    return replace(dataset, trials=tuple(averages), conditions=tuple(labels))


def without_crowding(data: Dataset) -> Dataset:
    """Return averaged data without most of what was measured once, where enough was measured repeatedly.

    A search measures its candidates once and its leaders again and again: they tell the noise, and each further
    candidate beside many says little and costs a simulation in every step of every fit. Kept are those farthest from
    what is kept already, in numbers of the condition, each in its range.
    """
    counts = [
        sum(data.trials[index].count for index in data.of_group(group))
        for group in range(len(data.conditions))
    ]
    kept = [group for group, count in enumerate(counts) if count > 1]
    once = [group for group, count in enumerate(counts) if count == 1]
    freedom = sum(count - 1 for count in counts)
    if freedom < criteria.ENOUGH_FREEDOM or len(counts) <= _MOST_CONDITIONS:
        return data
    places = _places([data.trials[data.of_group(group)[0]].condition for group in range(len(counts))])
    while len(kept) < _MOST_CONDITIONS and once:
        far = [float(np.min(np.linalg.norm(places[kept] - places[group], axis=1))) for group in once]
        kept.append(once.pop(int(np.argmax(far))))
    kept.sort()
    number = {group: index for index, group in enumerate(kept)}
    trials = tuple(
        replace(trial, group=number[trial.group]) for trial in data.trials if trial.group in number
    )
    message = (
        f"of {len(counts)} conditions {len(kept)} were looked at: all that were repeated, "
        "others far from each other"
    )
    labels = tuple(data.conditions[group] for group in kept)
    return replace(data, trials=trials, conditions=labels, notes=(*data.notes, message))


def _places(conditions: Sequence[Mapping[str, float | str]]) -> FloatArray:
    """Return conditions as points: numbers in their range, a word as an axis of its own."""
    columns = []
    for name in sorted({name for condition in conditions for name in condition}):
        values = [condition.get(name, "") for condition in conditions]
        numbers = np.array(
            [value if isinstance(value, float | int) else np.nan for value in values], dtype=float
        )
        if np.isfinite(numbers).all():
            columns.append((numbers - numbers.min()) / (np.ptp(numbers) or 1.0))
        else:
            columns += [
                np.array([float(value == word) for value in values]) for word in sorted(set(values), key=str)
            ]
    return np.column_stack(columns) if columns else np.zeros((len(conditions), 1))


def _check(trial: FitTrial, dataset: Dataset) -> None:
    fewest = 1 if not np.any(np.diff(trial.time_s)) else 2
    if len(trial.time_s) < fewest:
        raise RecordingError(f"{trial.label} of {dataset.name} has {len(trial.time_s)} samples")
    for what, values in (
        ("an input", trial.inputs),
        ("an output", trial.outputs),
        ("the time", trial.time_s),
    ):
        if not np.all(np.isfinite(values)):
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise RecordingError(
                f"{what} of {trial.label} of {dataset.name} is not a finite number in sample {row + 1}",
                hint="cut the trial there, or leave it out",
            )
    if np.any(np.diff(trial.time_s) <= 0):
        row = int(np.argmax(np.diff(trial.time_s) <= 0)) + 2
        raise RecordingError(
            f"the time of {trial.label} of {dataset.name} does not increase at sample {row}",
            hint="a clock went backwards or a sample is there twice: sort it out before asking for a diagnosis",
        )


def _on_one_time_base(trials: Sequence[FitTrial]) -> list[FitTrial] | None:
    """Return the trials at the times of the first; None if they did not take the same course.

    Sensors sample when they please: repeats of one command differ by a part of a sample. Their outputs are carried over
    by cubic splines, which change what is slow beside the sample rate by next to nothing.
    """
    if _same_course(trials):
        return list(trials)
    first, step_s = trials[0], _step_s(trials[0])
    apart = max(_SAMPLES_APART, _SHARE_APART * len(first.time_s))
    if any(abs(len(trial.time_s) - len(first.time_s)) > apart for trial in trials):
        return None
    if len(first.time_s) < _FEWEST_ALIGNED_SAMPLES:
        return None
    spread = np.maximum(np.std(first.inputs, axis=0), 1e-12)
    groups = []
    for trial in trials:
        ends = trial.time_s[[0, -1]] - first.time_s[[0, -1]]
        if np.any(np.abs(ends) > (_SAMPLES_APART + 1) * step_s):
            return None
        inputs = _carried(trial.time_s, trial.inputs, first.time_s, "linear")
        if np.any(np.sqrt(np.mean(np.square(inputs - first.inputs), axis=0)) > _SAME_INPUT * spread):
            return None
        outputs = _carried(trial.time_s, trial.outputs, first.time_s, "cubic")
        groups.append(replace(trial, time_s=first.time_s, inputs=first.inputs, outputs=outputs))
    return groups


def _carried(
    time_s: FloatArray, values: FloatArray, at_s: FloatArray, way: Literal["linear", "cubic"]
) -> FloatArray:
    """Return signals (n, k) at other times, held beyond their ends."""
    if values.shape[1] == 0:
        return np.empty((len(at_s), 0))
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(time_s, values, k=1 if way == "linear" else 3)
    return np.asarray(spline(np.clip(at_s, time_s[0], time_s[-1])))


def _same_course(trials: Sequence[FitTrial]) -> bool:
    """Tell whether time bases and inputs are the same for all."""
    first = trials[0]
    return all(
        len(trial.time_s) == len(first.time_s)
        and np.allclose(trial.time_s, first.time_s, rtol=0.0, atol=1e-6 * _step_s(first))
        and np.allclose(trial.inputs, first.inputs, rtol=1e-9, atol=1e-12)
        for trial in trials[1:]
    )


def _step_s(trial: FitTrial) -> float:
    return float(np.median(np.diff(trial.time_s))) if len(trial.time_s) > 1 else 1.0


def _same_beginning(trials: Sequence[FitTrial]) -> bool:
    """Tell whether the first samples of repeats differ no more than the samples after them do."""
    outputs = np.stack([trial.outputs for trial in trials])
    if outputs.shape[1] < _FEWEST_ALIGNED_SAMPLES:
        return True
    spread = np.sqrt(np.mean(np.var(outputs, axis=0, ddof=1), axis=0))
    begin = np.mean(outputs[:, :FIRST_SAMPLES], axis=1)
    return bool(np.all(np.ptp(begin, axis=0) <= criteria.SAME_BEGINNING * spread + 1e-12))


def _mean(trials: Sequence[FitTrial], group: int) -> FitTrial:
    members = tuple(trial.outputs for trial in trials)
    label = condition_text(trials[0].condition) or trials[0].label
    return replace(trials[0], label=label, outputs=np.mean(members, axis=0), group=group, members=members)
