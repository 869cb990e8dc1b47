"""Trials of a recorded run as a dataset: streams of several devices brought onto one time base."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RecordingError, RequestError
from labrun.fit.dataset import Dataset, FitTrial, Named, Ports, require_trials, resample
from labrun.signals import Signals
from labrun.spec import condition_text
from labrun.store import COMMAND, SignalInfo, TrialOutcome, imported_channels


def from_run(target: Path, model: Ports, signals: Mapping[str, str]) -> Dataset:
    """Return the accepted trials of a run for a model.

    Outputs of the device that gives the first one stay as they were sampled; other outputs are interpolated onto their
    times, commands run linearly between their points. Tares are subtracted. Only samples between the start and
    the end of the trial count.

    Raises
    ------
    RequestError
        A signal that names no device or channel of the run.
    FitError
        No trial left to fit.
    """
    from labrun.store import open_run

    run = open_run(target)
    channels = imported_channels(run.experiment_toml)
    accepted = [outcome for outcome in run.outcomes if outcome.status == "done"]
    left_out = len(run.outcomes) - len(accepted)
    trials: list[FitTrial] = []
    inputs: tuple[SignalInfo, ...] = ()
    outputs: tuple[SignalInfo, ...] = ()
    for outcome in accepted:
        streams = run.measured(outcome.index)
        sources = {
            port.name: _find(port, streams, signals, target) for port in (*model.inputs, *model.outputs)
        }
        trials.append(_trial(outcome, model, streams, sources, whole=bool(channels)))
        inputs = tuple(_info(port, streams, sources, channels) for port in model.inputs)
        outputs = tuple(_info(port, streams, sources, {}) for port in model.outputs)
    require_trials(trials, target, left_out)
    return Dataset(run.name, target, "run", inputs, outputs, tuple(trials), left_out)


def _trial(
    outcome: TrialOutcome,
    model: Ports,
    streams: Mapping[str, Signals],
    sources: Mapping[str, tuple[str, str]],
    *,
    whole: bool,
) -> FitTrial:
    base = streams[sources[model.outputs[0].name][0]].time_s
    end_s = outcome.duration_s if outcome.duration_s > 0 else np.inf
    # a sample of the very start may be dated a moment before it: clocks are only estimated
    time_s = base if whole else base[(base >= -1e-3) & (base <= end_s + 1e-3)]
    if len(time_s) < 2:
        raise RecordingError(
            f"trial {outcome.index} has {len(time_s)} samples of {'.'.join(sources[model.outputs[0].name])} "
            "between its start and its end",
            hint="labrun show tells what was recorded; a trial without data can be marked rejected",
        )

    def table(ports: Sequence[Named]) -> FloatArray:
        columns = [_column(streams[sources[port.name][0]], sources[port.name][1], time_s) for port in ports]
        return np.column_stack(columns) if columns else np.empty((len(time_s), 0))

    label = condition_text(outcome.condition)
    return FitTrial(
        f"trial {outcome.index}: {label}" if label else f"trial {outcome.index}",
        outcome.condition,
        outcome.repeat,
        time_s,
        table(model.inputs),
        table(model.outputs),
    )


def _column(signals: Signals, channel: str, time_s: FloatArray) -> FloatArray:
    measured = signals.signal(channel)
    known = np.isfinite(measured.values)
    return resample(measured.time_s[known], measured.values[known], time_s, "linear")


def _find(
    port: Named, streams: Mapping[str, Signals], signals: Mapping[str, str], target: Path
) -> tuple[str, str]:
    """Return device and channel of a port: as `signals` says, or the only channel of that name."""
    known = [f"{device}.{column}" for device, table in streams.items() for column in table.columns]
    wanted = signals.get(port.name)
    if wanted is None:
        same = [name for name in known if name.partition(".")[2] == port.name]
        measured = [name for name in same if not name.startswith(f"{COMMAND}.")]
        same = measured or same
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
        said = f"is said to be {wanted!r}, which" if wanted else "has no channel of its name and"
        raise RequestError(
            f"the model's {port.name!r} {said} is not in {target}",
            hint=f"{hint}; [fit.signals] says which channel is what",
        )
    device, _, channel = wanted.partition(".")
    return device, channel


def _info(
    port: Named,
    streams: Mapping[str, Signals],
    sources: Mapping[str, tuple[str, str]],
    channels: Mapping[str, Any],
) -> SignalInfo:
    device, channel = sources[port.name]
    unit = streams[device].unit(channel)
    return SignalInfo(port.name, unit, channels.get(channel, {}).get("between", "linear"))
