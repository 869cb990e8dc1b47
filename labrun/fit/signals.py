"""Recorded trials as the signals a fit is made of, each on one even time base."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.fit.signal_table import SignalTable
from labrun.signals import Signals
from labrun.spec import condition_text
from labrun.store import (
    RecordedTrial,
    SignalInfo,
    imported_channels,
    is_recording,
    read_recording,
)
from labrun.toml import nearest

if TYPE_CHECKING:
    from labrun.spec import Experiment
    from labrun.store import TrialOutcome

COMMAND = "command"
GAIT = "gait"
"""The pseudo device of a gait's named quantities over time."""
_EVEN = 1e-6
Channel = tuple[FloatArray, str]
"""Values at the trial's times, and their unit."""


@dataclass(frozen=True, slots=True)
class SignalTrial:
    """One trial's signals.

    Attributes
    ----------
    label
        Names it in figures and messages.
    time_s : (n,)
        From the start of the trial, evenly spaced.
    values : name -> (n,)
    period_s
        Of a gait cycle; None if the gait has none.
    """

    label: str
    condition: Mapping[str, float | str]
    repeat: int
    time_s: FloatArray
    values: Mapping[str, FloatArray]
    period_s: float | None = None

    @property
    def step_s(self) -> float:
        """Time between two samples."""
        return float(self.time_s[1] - self.time_s[0])


@dataclass(frozen=True, slots=True)
class SignalSet:
    """The same signals of every accepted trial, with their units.

    Attributes
    ----------
    left_out
        Trials that were rejected or failed; those that `where` excludes do not count.
    """

    name: str
    kind: Literal["recording", "run"]
    trials: tuple[SignalTrial, ...]
    units: Mapping[str, str]
    left_out: int = 0


def load_signals(
    target: Path,
    wanted: Mapping[str, SignalTable],
    *,
    where: Mapping[str, float | str] | None = None,
    rate_hz: float | None = None,
) -> SignalSet:
    """Load signals of a run or a recording.

    Parameters
    ----------
    target
        A recording folder, a run folder or a run.h5.
    wanted
        Signals by the name the fit gives them.
    where
        Only trials whose condition has these values.
    rate_hz
        Of the time base; None takes that of the first measured channel.

    Raises
    ------
    RequestError
        A channel that was not recorded, or a name the gait does not have; with the nearest.
    FitError
        No trial is left, or one is too short.
    """
    load = _recording if is_recording(target) else _run
    name, kind, trials, left_out = load(target, wanted, dict(where or {}), rate_hz)
    if not trials:
        why = "no accepted trial" if left_out else "no trial"
        only = f" with {condition_text(dict(where))}" if where else ""
        raise FitError(
            f"nothing to fit in {target}: it has {why}{only}", hint=f"labrun show {target} lists its trials"
        )
    units = trials[0][1]
    return SignalSet(name, kind, tuple(trial for trial, _ in trials), units, left_out)


def trailing_mean(values: FloatArray, samples: int) -> FloatArray:
    """Return the mean of each value and the `samples` - 1 before it; of what there is at the beginning."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    last = np.arange(1, len(values) + 1)
    first = np.maximum(last - samples, 0)
    return np.asarray((total[last] - total[first]) / (last - first))


_Loaded = tuple[str, Literal["recording", "run"], list[tuple[SignalTrial, dict[str, str]]], int]


def _run(
    target: Path, wanted: Mapping[str, SignalTable], where: Mapping[str, float | str], rate_hz: float | None
) -> _Loaded:
    from labrun.spec import loads_experiment
    from labrun.store import open_run

    run = open_run(target)
    imported = bool(imported_channels(run.experiment_toml))
    experiment = (
        None if imported else loads_experiment(run.experiment_toml, run.name, plugins=False).experiment
    )
    wanted_here = [one for one in run.outcomes if _matches(one.condition, where)]
    accepted = [one for one in wanted_here if one.status == "done"]
    trials = []
    for outcome in accepted:
        measured = run.measured(outcome.index)
        trials.append(_run_trial(outcome, measured, experiment, wanted, rate_hz, target))
    return run.name, "run", trials, len(wanted_here) - len(accepted)


def _run_trial(
    outcome: "TrialOutcome",
    signals: Mapping[str, Signals],
    experiment: "Experiment | None",
    wanted: Mapping[str, SignalTable],
    rate_hz: float | None,
    target: Path,
) -> tuple[SignalTrial, dict[str, str]]:
    devices = [one.channel.partition(".")[0] for one in wanted.values()]
    measured = [signals[device] for device in devices if device in signals and device != COMMAND]
    base = measured[0] if measured else next(iter(signals.values()))
    end_s = outcome.duration_s if outcome.duration_s > 0 else float(base.time_s[-1])
    label = f"trial {outcome.index}: {condition_text(outcome.condition)}".rstrip(": ")
    time_s = _even(0.0, end_s, rate_hz or base.rate_hz, label)

    def channel(name: str) -> Channel:
        device, _, part = name.partition(".")
        if device == GAIT and experiment is not None:
            return _gait_value(experiment, outcome.condition, part, time_s)
        known = {f"{device}.{column}": None for device, table in signals.items() for column in table.columns}
        if name not in known:
            raise _unknown(name, known, target)
        found = signals[device].signal(part)
        return _at(found.time_s, found.values, time_s, name, label), found.unit

    return _trial(label, outcome.condition, outcome.repeat, time_s, outcome.period_s, wanted, channel)


def _recording(
    target: Path, wanted: Mapping[str, SignalTable], where: Mapping[str, float | str], rate_hz: float | None
) -> _Loaded:
    recording = read_recording(target)
    infos = (*recording.inputs, *recording.outputs)
    trials = []
    for number, trial in enumerate(recording.trials):
        if _matches(trial.condition, where):
            trials.append(_recorded_trial(number, trial, infos, wanted, rate_hz, target))
    return recording.name, "recording", trials, 0


def _recorded_trial(
    number: int,
    trial: RecordedTrial,
    infos: Sequence[SignalInfo],
    wanted: Mapping[str, SignalTable],
    rate_hz: float | None,
    target: Path,
) -> tuple[SignalTrial, dict[str, str]]:
    label = f"trial {number}: {condition_text(trial.condition)}".rstrip(": ")
    rate = rate_hz or 1.0 / float(np.median(np.diff(trial.time_s)))
    time_s = _even(float(trial.time_s[0]), float(trial.time_s[-1]), rate, label)
    table = np.column_stack([trial.inputs, trial.outputs])
    known = {info.name: column for column, info in enumerate(infos)}

    def channel(name: str) -> Channel:
        if name not in known:
            raise _unknown(name, known, target)
        column = known[name]
        return _at(trial.time_s, table[:, column], time_s, name, label), infos[column].unit

    return _trial(label, trial.condition, trial.repeat, time_s, None, wanted, channel)


def _trial(
    label: str,
    condition: Mapping[str, float | str],
    repeat: int,
    time_s: FloatArray,
    period_s: float | None,
    wanted: Mapping[str, SignalTable],
    channel: Callable[[str], Channel],
) -> tuple[SignalTrial, dict[str, str]]:
    values, units = {}, {}
    for name, table in wanted.items():
        values[name], unit = _signal(table, channel, time_s, period_s, label)
        units[name] = table.unit(unit)
    return SignalTrial(label, condition, repeat, time_s, values, period_s), units


def _signal(
    table: SignalTable,
    channel: Callable[[str], Channel],
    time_s: FloatArray,
    period_s: float | None,
    label: str,
) -> Channel:
    parts, unit = [], ""
    for name, scale in zip(table.channels, (table.scale, table.side_scale), strict=False):
        values, named = channel(name)
        unit = unit or named
        values = values * scale / (table.divide_by_m or 1.0)
        if table.average == "cycle":
            if period_s is None:
                raise RequestError(
                    f"{name} cannot be averaged over a cycle: the gait of {label} has none",
                    hint='give the gait a frequency_hz, or use average = "none"',
                )
            values = trailing_mean(values, max(1, round(period_s / float(time_s[1] - time_s[0]))))
        parts.append(values)
    if table.take == "magnitude":
        return np.hypot(*parts), unit
    if table.take == "direction":
        return np.degrees(np.arctan2(parts[1], parts[0])), unit
    return parts[0], unit


def _gait_value(
    experiment: "Experiment", condition: Mapping[str, float | str], name: str, time_s: FloatArray
) -> Channel:
    from labrun.toml import resolve

    known = resolve(experiment.gait.let, {**condition, "t": time_s})
    value = known.get(name)
    if value is None or isinstance(value, str) or name == "t":
        near = nearest(name, [one for one in known if one != "t"])
        hint = f"did you mean gait.{near}?" if near else f"it has {', '.join(f'gait.{one}' for one in known)}"
        raise RequestError(f"the gait and its conditions have no number named {name!r}", hint=hint)
    unit = experiment.units.get(name, "1")
    return np.broadcast_to(np.asarray(value, dtype=float), time_s.shape).copy(), unit


def _matches(condition: Mapping[str, float | str], where: Mapping[str, float | str]) -> bool:
    return all(condition.get(name) == value for name, value in where.items())


def _even(start_s: float, end_s: float, rate_hz: float, label: str) -> FloatArray:
    count = int((end_s - start_s) * rate_hz * (1 + _EVEN)) + 1
    if count < 2:
        raise FitError(f"{label} is too short to be fitted: {end_s - start_s:.3g} s at {rate_hz:.3g} Hz")
    return start_s + np.arange(count) / rate_hz


def _at(time_s: FloatArray, values: FloatArray, at_s: FloatArray, name: str, label: str) -> FloatArray:
    finite = np.isfinite(values)
    if np.count_nonzero(finite) < 2:
        raise FitError(
            f"{name} has fewer than 2 samples in {label}", hint="mark the trial rejected, or measure again"
        )
    return np.interp(at_s, time_s[finite], values[finite])


def _unknown(name: str, known: Mapping[str, object], target: Path) -> RequestError:
    near = nearest(name, list(known))
    hint = f"did you mean {near!r}?" if near else f"recorded were {', '.join(known)}"
    return RequestError(f"no channel {name!r} in {target}", hint=hint)
