"""Measured trials as a model sees them: its inputs and outputs, on the time base of its outputs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import FitError, RecordingError, RequestError
from labrun.experiment import CYCLES, condition_text
from labrun.models import Input, Model, Output
from labrun.signals import Signals
from labrun.store import (
    COMMAND,
    Recording,
    SignalInfo,
    TrialOutcome,
    imported_channels,
    is_recording,
    open_run,
    read_recording,
)

_FALLS = 0.5
"""What breaks loses at least this share of its peak,"""
_WITHIN = 10
"""within so many samples; a sensor at the end of its range stays there."""
CYCLE = "cycle"
"""Condition that numbers the kept cycles of a trial which went on until something happened."""


Port = Input | Output | SignalInfo
"""An input or output of a model: a name and a unit, "1" where the model does not say."""


@dataclass(frozen=True, slots=True)
class OutputsAlone:
    """The ports of a fit that reads measured outputs and simulates nothing."""

    outputs: Sequence[Port]
    inputs: Sequence[Port] = ()


Ports = Model | OutputsAlone
"""What a dataset is loaded for."""


@dataclass(frozen=True, slots=True)
class FitTrial:
    """One trial.

    Attributes
    ----------
    label
        Names it in figures and messages.
    time_s : (n,)
        Strictly increasing.
    inputs : (n, k)
        In the model's order.
    outputs : (n, m)
        In the model's order.
    file
        A table with one header line that it was read from; None if it came from elsewhere.
    group
        Number of its condition, in a dataset that knows its conditions.
    mounting
        Number of the mounting it belongs to, where specimens were set by hand.
    members : per repeat (n, m)
        Measured outputs of the repeats that `outputs` is the mean of; empty where it is one trial.
    """

    label: str
    condition: Mapping[str, float | str]
    repeat: int
    time_s: FloatArray
    inputs: FloatArray
    outputs: FloatArray
    file: Path | None = None
    group: int = 0
    members: tuple[FloatArray, ...] = ()
    mounting: int | None = None

    @property
    def count(self) -> int:
        """Number of repeats it is the mean of."""
        return max(len(self.members), 1)

    def first(self, samples: int) -> "FitTrial":
        """Return its beginning."""
        return self.kept(slice(0, samples))

    def kept(self, rows: slice) -> "FitTrial":
        """Return some of its samples."""
        return replace(self, **{key: getattr(self, key)[rows] for key in ("time_s", "inputs", "outputs")})


@dataclass(frozen=True, slots=True)
class Dataset:
    """Trials of one recording or run, for one model.

    Attributes
    ----------
    source
        Where the data came from; `kind` says what that is.
    left_out
        Trials that were rejected or failed.
    conditions
        Labels of the conditions that the trials' groups count, where repeats were averaged; else empty.
    """

    name: str
    source: Path
    kind: Literal["recording", "run"]
    inputs: tuple[SignalInfo, ...]
    outputs: tuple[SignalInfo, ...]
    trials: tuple[FitTrial, ...]
    left_out: int = 0
    notes: tuple[str, ...] = ()
    conditions: tuple[str, ...] = ()

    @property
    def signal_units(self) -> dict[str, str]:
        """Units of inputs and outputs, as recorded."""
        return {signal.name: signal.unit for signal in (*self.inputs, *self.outputs)}

    @property
    def repeats(self) -> int:
        """The fewest trials of any condition."""
        groups = {trial.group for trial in self.trials}
        return min(sum(trial.count for trial in self.trials if trial.group == group) for group in groups)

    def of_group(self, group: int) -> list[int]:
        """Return the places of the trials of a condition."""
        return [index for index, trial in enumerate(self.trials) if trial.group == group]


DataCheck = Callable[[Dataset], Dataset]
"""Returns the trials of a dataset that can be fitted; raises RecordingError if none can."""


def unchecked(dataset: Dataset) -> Dataset:
    """Return a dataset as it is."""
    return dataset


def load_dataset(target: Path, model: Ports, signals: Mapping[str, str] | None = None) -> Dataset:
    """Load a recording folder, a run folder or a run.h5 for a model, whose ports are looked for by name.

    Parameters
    ----------
    signals
        Which recorded channel is which input or output of the model, where their names differ: for a run
        ``"device.channel"`` or ``"command.joint"``, for a recording the name of a channel.

    Raises
    ------
    RequestError
        Neither a recording nor a run; a signal that nothing recorded, with the nearest name.
    FitError
        No trial left to fit.
    """
    wanted = dict(signals or {})
    ports = [port.name for port in (*model.inputs, *model.outputs)]
    for name in wanted:
        if name not in ports:
            raise RequestError(
                f"signals names {name!r}, which is neither an input nor an output of the model",
                hint=f"it has {', '.join(ports)}",
            )
    if is_recording(target):
        return _from_recording(read_recording(target), target, model, wanted)
    return _from_run(target, model, wanted)


def _from_run(target: Path, model: Ports, signals: Mapping[str, str]) -> Dataset:
    """Return the accepted trials of a run for a model.

    Outputs of the device that gives the first one stay as they were sampled; other outputs are interpolated onto their
    times, commands run linearly between their points. Tares are subtracted. Only samples between the start and
    the end of the trial count, and where something is commanded the last one before the start. A trial that went on
    until something happened is as many trials as cycles whose samples were kept, each from its own beginning, with its
    number (from 0) as the condition ``cycle``.
    """
    run = open_run(target)
    channels = imported_channels(run.experiment_toml)
    accepted = [outcome for outcome in run.outcomes if outcome.status == "done"]
    left_out = len(run.outcomes) - len(accepted)
    units = run.units()
    trials: list[FitTrial] = []
    inputs: tuple[SignalInfo, ...] = ()
    outputs: tuple[SignalInfo, ...] = ()
    for outcome in accepted:
        measured = run.measured(outcome.index)
        sources = {
            port.name: _find(port, measured, signals, target) for port in (*model.inputs, *model.outputs)
        }
        trials += _run_trials(outcome, model, measured, sources, units, whole=bool(channels))
        inputs, outputs = (
            tuple(_info(port, measured, sources, channels) for port in ports)
            for ports in (model.inputs, model.outputs)
        )
    if not trials:
        lost = "its only trial was" if left_out == 1 else f"all {left_out} of its trials were"
        what = f"{lost} rejected or failed" if left_out else "it has no trials yet"
        hint = "labrun show tells why trials were rejected"
        raise FitError(f"nothing to fit in {target}: {what}", hint=hint)
    return Dataset(run.name, target, "run", inputs, outputs, tuple(trials), left_out)


def until_peak(data: Dataset, output: int) -> Dataset:
    """Return trials up to where an output is greatest, of those in which it then falls: something broke."""
    trials, short = [], 0
    for trial in data.trials:
        signal = trial.outputs[:, output]
        samples = int(np.argmax(signal)) + 1
        after = signal[samples : samples + _WITHIN]
        broke = len(after) > 0 and float(after.min()) < (1.0 - _FALLS) * float(signal.max())
        short += broke
        trials.append(trial.first(samples) if broke and samples > 1 else trial)
    if not short:
        return data
    counted = "1 trial counts" if short == 1 else f"{short} trials count"
    note = f"{counted} up to where {data.outputs[output].name} is greatest only"
    return replace(data, trials=tuple(trials), notes=(*data.notes, note))


def thinned(data: Dataset, rate_hz: float | None = None, until_s: float | None = None) -> Dataset:
    """Return trials up to `until_s` after their first samples, with every so manieth of them that they are `rate_hz`.

    Samples are left out and not averaged, which would flatten what is fast.
    """

    def cut(trial: FitTrial) -> FitTrial:
        since_s = trial.time_s - trial.time_s[0]
        samples = len(since_s) if until_s is None else int(np.searchsorted(since_s, until_s, side="right"))
        every = 1 if rate_hz is None else max(round(1.0 / (rate_hz * float(np.median(np.diff(since_s))))), 1)
        return trial.kept(slice(0, max(samples, 2), every))

    parts = [
        "" if until_s is None else f"up to {until_s:g} s",
        "" if rate_hz is None else f"at about {rate_hz:g} Hz",
    ]
    note = f"as [gap] says, trials were looked at {' and '.join(filter(None, parts))}"
    return replace(data, trials=tuple(cut(trial) for trial in data.trials), notes=(*data.notes, note))


def _run_trials(
    outcome: TrialOutcome,
    model: Ports,
    measured: Mapping[str, Signals],
    sources: Mapping[str, tuple[str, str]],
    units: Mapping[str, str],
    *,
    whole: bool,
) -> list[FitTrial]:
    base = measured[sources[model.outputs[0].name][0]].time_s
    end_s = outcome.duration_s if outcome.duration_s > 0 else np.inf
    # a sample of the very start may be dated a moment before it: clocks are only estimated
    first, last = np.searchsorted(base, [-1e-3, end_s + 1e-3])
    commanded = any(sources[port.name][0] == COMMAND for port in model.inputs)
    from_rest = commanded and CYCLES not in measured and 0 < first < last and base[first] > 0.0
    first -= (
        from_rest  # until a motion starts, a bench stands where it begins: there a simulation can begin, too
    )
    time_s = base if whole else base[first:last]
    if from_rest and not whole and all(getattr(port, "between", "") == "linear" for port in model.inputs):
        # What was seen then would be seen at 0, too, where commands begin: a kink that a longer step would smear.
        time_s = np.append(0.0, time_s[1:])
    if len(time_s) < 2:
        raise RecordingError(
            f"trial {outcome.index} has {len(time_s)} samples of {'.'.join(sources[model.outputs[0].name])} "
            "between its start and its end",
            hint="labrun show tells what was recorded; a trial without data can be marked rejected",
        )

    def table(ports: Sequence[Port], at_s: FloatArray, begin_s: float) -> FloatArray:
        columns = []
        for port in ports:
            device, channel = sources[port.name]
            # the command is stored once: every cycle repeats it
            columns.append(measured[device].signal(channel).at(at_s - begin_s * (device == COMMAND)))
        return np.column_stack(columns) if columns else np.empty((len(at_s), 0))

    def made(at_s: FloatArray, begin_s: float, condition: Mapping[str, float | str]) -> FitTrial:
        return FitTrial(
            f"trial {outcome.index}: {condition_text(condition, units)}".rstrip(": "),
            condition,
            outcome.repeat,
            at_s - begin_s,
            table(model.inputs, at_s, begin_s),
            table(model.outputs, at_s, begin_s),
            mounting=outcome.mounting,
        )

    if CYCLES not in measured:
        return [made(time_s, 0.0, outcome.condition)]
    period_s = outcome.duration_s / len(measured[CYCLES].time_s)
    numbers = np.floor((time_s + 1e-3) / period_s)
    return [
        made(time_s[numbers == number], float(number * period_s), {**outcome.condition, CYCLE: float(number)})
        for number in np.unique(numbers)
        if np.count_nonzero(numbers == number) > 1
    ]


def _find(
    port: Port, measured: Mapping[str, Signals], signals: Mapping[str, str], target: Path
) -> tuple[str, str]:
    """Return device and channel of a port: as `signals` says, or the only channel of that name."""
    known = [f"{device}.{column}" for device, table in measured.items() for column in table.columns]
    wanted = signals.get(port.name)
    if wanted is None:
        same = [name for name in known if name.partition(".")[2] == port.name]
        same = [name for name in same if not name.startswith(f"{COMMAND}.")] or same
        if len(same) == 1:
            wanted = same[0]
        elif same:
            raise RequestError(
                f"the model's {port.name!r} could be {' or '.join(same)} of {target}",
                hint="say which in [fit.signals]",
            )
    if wanted not in known:
        near = get_close_matches(wanted or port.name, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"recorded were {', '.join(known)}"
        explanation = f"is said to be {wanted!r}, which" if wanted else "has no channel of its name and"
        raise RequestError(
            f"the model's {port.name!r} {explanation} is not in {target}",
            hint=f"{hint}; [fit.signals] says which channel is what",
        )
    device, _, channel = wanted.partition(".")
    return device, channel


def _info(
    port: Port,
    measured: Mapping[str, Signals],
    sources: Mapping[str, tuple[str, str]],
    channels: Mapping[str, Any],
) -> SignalInfo:
    device, channel = sources[port.name]
    unit = measured[device].unit(channel)
    stated = channels.get(channel, {})
    return SignalInfo(port.name, unit, stated.get("between", "linear"), stated.get("reading_error"))


def _from_recording(recording: Recording, source: Path, model: Ports, signals: Mapping[str, str]) -> Dataset:
    """Return the trials of a recording for a model."""
    inputs, named_inputs = _columns(model.inputs, recording.inputs, "input", signals, source)
    outputs, named_outputs = _columns(model.outputs, recording.outputs, "output", signals, source)
    trials = []
    for trial in recording.trials:
        label = condition_text(trial.condition) or trial.source_file.stem
        repeated = sum(other.condition == trial.condition for other in recording.trials) > 1
        trials.append(
            FitTrial(
                f"{label}, repeat {trial.repeat}" if repeated else label,
                trial.condition,
                trial.repeat,
                trial.time_s,
                np.ascontiguousarray(trial.inputs[:, inputs]),
                np.ascontiguousarray(trial.outputs[:, outputs]),
                trial.source_file,
            )
        )
    return Dataset(recording.name, source, "recording", named_inputs, named_outputs, tuple(trials))


def _columns(
    ports: Sequence[Port], channels: Sequence[SignalInfo], kind: str, signals: Mapping[str, str], source: Path
) -> tuple[list[int], tuple[SignalInfo, ...]]:
    """Return which channel each port is, and what is known of it under the port's name."""
    names = [channel.name for channel in channels]
    indices = []
    for port in ports:
        wanted = signals.get(port.name, port.name)
        if wanted not in names:
            near = get_close_matches(wanted, names, n=1)
            listed = f"its {kind} channels are {', '.join(names) or 'none'}"
            raise RequestError(
                f"the model's {kind} {port.name!r} is not an {kind} channel of {source}",
                hint=f"did you mean {near[0]!r}?" if near else listed,
            )
        index = names.index(wanted)
        if port.unit not in ("", "1") and port.unit != channels[index].unit:
            raise RequestError(
                f"the model's {kind} {port.name!r} is in {port.unit}, "
                f"the channel {wanted!r} of {source} in {channels[index].unit}",
                hint="say the same unit in the model and in recording.toml, converting the numbers of one of them",
            )
        indices.append(index)
    named = zip(ports, indices, strict=True)
    return indices, tuple(replace(channels[index], name=port.name) for port, index in named)
