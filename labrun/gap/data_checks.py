"""Data that cannot be diagnosed: clocks that jump or disagree, and outputs that carry nothing."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labrun.errors import RecordingError
from labrun.experiment import condition_key
from labrun.fit import FEWEST_SAMPLES, Dataset, FitTrial
from labrun.gap import numerics

_LONG_STEP = 5.0
"""A time step this many times as long as the usual one is a jump of the clock, or samples are missing."""
_SELDOM = 0.02
"""Where a larger part of the steps is long, a trial was sampled unevenly on purpose."""
_SHORT_HOLE = 0.01
"""Part of a trial's duration up to which a long step shifts little of what comes after it."""
_INTERVALS_APART = 0.005
"""Part by which the sampling intervals of repeats may differ."""
_CONSTANT_OUTPUT = 1e-9
"""Part of an output's size by which its values differ from rounding alone."""
_FEWEST_LEVELS = 2
"""An output that moves by no more steps of its resolution than this is not told from a constant one."""

_SHOWN = 3


@dataclass(frozen=True)
class CheckedTrials:
    """Trials whose clocks can be believed.

    Attributes
    ----------
    limitations, notes
        What was found, in sentences: what it means for the answer, and every place.
    """

    dataset: Dataset
    limitations: tuple[str, ...]
    notes: tuple[str, ...]


def with_sound_clocks(dataset: Dataset) -> CheckedTrials:
    """Leave out trials in which time jumps, and say where the clocks of repeats disagree.

    A jump is a step of more than five times the trial's median one and more than a hundredth of its duration. Shorter
    ones are noted. Trials of fewer than 21 samples, and those of which more than a fiftieth of the steps are long, say
    nothing about their clock.

    Raises
    ------
    RecordingError
        Time jumps in every trial.
    """
    kept, jumping, notes, short, uneven = list[FitTrial](), list[str](), list[str](), 0, list[str]()
    for trial in dataset.trials:
        usual_s, long = _long_steps(trial)
        if not len(long):
            kept.append(trial)
        elif len(long) > max(1.0, _SELDOM * (len(trial.time_s) - 1)):
            kept.append(trial)
            uneven.append(_called(trial))
        else:
            steps_s = np.diff(trial.time_s)[long]
            notes += [
                f"{_place(trial, int(at))}: time goes on by {step:.3g} s; the usual step is {usual_s:.3g} s"
                for at, step in zip(long, steps_s, strict=True)
            ]
            if np.max(steps_s) > _SHORT_HOLE * float(trial.time_s[-1] - trial.time_s[0]):
                jumping.append(f"{_place(trial, int(long[np.argmax(steps_s)]))} ({np.max(steps_s):.3g} s)")
            else:
                kept.append(trial)
                short += 1
    if not kept:
        raise RecordingError(
            f"time jumps in every trial of {dataset.name}: {_listed(jumping)}",
            hint="if only the clock jumped, mend the times; if samples are missing, make a trial of each part",
        )
    limitations = []
    if jumping:
        limitations.append(
            f"{_trials(len(jumping))} left out, because time jumps there: {_listed(jumping)}. If only the clock "
            "jumped, mend the times; if samples are missing, make a trial of each part."
        )
    if short:
        limitations.append(
            f"Short holes in the time of {short} trial{'s' * (short > 1)}, see the notes: inputs were taken to run "
            "straight across them. If the clock jumped there, delays are not to be told."
        )
    if uneven:
        limitations.append(
            f"Sampled unevenly: {_listed(uneven)}. This was taken to be on purpose; whether their clocks jumped was "
            "not told."
        )
    dataset = replace(dataset, trials=tuple(kept))
    return CheckedTrials(dataset, (*limitations, *_disagreeing(dataset)), tuple(notes))


def _disagreeing(dataset: Dataset) -> tuple[str, ...]:
    """Return a sentence where repeats of a condition were sampled at intervals that differ."""
    groups: dict[object, list[tuple[FitTrial, float]]] = {}
    for trial in dataset.trials:
        interval_s = _interval_s(trial)
        if interval_s is not None:
            groups.setdefault(condition_key(trial.condition), []).append((trial, interval_s))
    checks = []
    for group in groups.values():
        for index, (trial, interval_s) in enumerate(group):
            # of two, nobody can say which is wrong: each is held against the other
            compared = group if len(group) != 2 else [group[1 - index]]
            apart = interval_s / float(np.median([interval for _, interval in compared])) - 1.0
            if abs(apart) > _INTERVALS_APART:
                checks.append(f"{_called(trial)} ({100 * apart:+.1f} %)")
    if not checks:
        return ()
    return (
        f"Repeats were not sampled at one interval: {_listed(checks)} beside the others of the condition. If a clock "
        "runs wrong there, what is said to be ruled out may be wrong, too: correct these times or take the trials out, "
        "and diagnose again.",
    )


def _long_steps(trial: FitTrial) -> tuple[float, NDArray[np.intp]]:
    """Return the median step in s and the places of steps that are far longer."""
    steps_s = np.diff(trial.time_s)
    if len(steps_s) < numerics.FEWEST_STEPS:
        return 0.0, np.empty(0, dtype=np.intp)
    usual_s = float(np.median(steps_s))
    return usual_s, np.flatnonzero(steps_s > _LONG_STEP * usual_s) if usual_s > 0 else np.empty(
        0, dtype=np.intp
    )


def _interval_s(trial: FitTrial) -> float | None:
    """Return the mean step without holes, s; None where there are too few to tell."""
    steps_s = np.diff(trial.time_s)
    if len(steps_s) < numerics.FEWEST_STEPS or not np.median(steps_s) > 0:
        return None
    return float(np.mean(steps_s[steps_s <= _LONG_STEP * np.median(steps_s)]))


def _called(trial: FitTrial) -> str:
    return trial.label if trial.file is None else trial.file.name


def _place(trial: FitTrial, step: int) -> str:
    """Return where a step ends: the line of a file with a header, else the sample."""
    if trial.file is None:
        return f"{trial.label}, sample {step + 2}"
    return f"{trial.file.name}:{step + 3}"


def _trials(number: int) -> str:
    return "1 trial was" if number == 1 else f"{number} trials were"


def _listed(items: Sequence[str]) -> str:
    more = f" and {len(items) - _SHOWN} more" if len(items) > _SHOWN else ""
    return ", ".join(items[:_SHOWN]) + more


def require_informative(dataset: Dataset) -> None:
    """Refuse an output that does not move beyond rounding, or by at most two steps of its resolution.

    Any model is infinitely far from it in units of its noise, and an offset would seem to explain all of that.

    Raises
    ------
    RecordingError
        With the output, the number it shows, and what to do.
    """
    for column, output in enumerate(dataset.outputs):
        values = np.concatenate([trial.outputs[:, column] for trial in dataset.trials])
        if not np.all(np.isfinite(values)):
            continue  # said elsewhere, with its place
        size, span = float(np.max(np.abs(values))), float(np.ptp(values))
        levels = np.unique(values)
        unit = "" if output.unit in ("", "1") else f" {output.unit}"
        if span <= _CONSTANT_OUTPUT * size:
            shown = "zero" if size == 0.0 else f"{float(np.median(values)):.6g}{unit}"
            what = f"is {shown} throughout {dataset.name}"
        elif len(values) >= FEWEST_SAMPLES and _few_steps(levels, span):
            step = float(np.min(np.diff(levels)))
            steps = f"{round(span / step)} of its steps of {step:.3g}{unit}"
            what = f"moves by no more than {steps} throughout {dataset.name}"
        else:
            continue
        others = [port.name for index, port in enumerate(dataset.outputs) if index != column]
        rest = (
            f"take it out of the model's outputs, and diagnose with {', '.join(others)}"
            if others
            else "it is the model's only output, so that nothing is left to diagnose: record it again"
        )
        raise RecordingError(
            f"output {output.name!r} {what}: it says nothing about the model",
            hint=f"was the sensor connected, and is its range right? {rest}",
        )


def _few_steps(levels: np.ndarray[tuple[int], np.dtype[np.float64]], span: float) -> bool:
    """Tell whether different values are a few neighbouring steps of one resolution."""
    return len(levels) <= _FEWEST_LEVELS + 1 and span <= (_FEWEST_LEVELS + 0.01) * float(
        np.min(np.diff(levels))
    )
