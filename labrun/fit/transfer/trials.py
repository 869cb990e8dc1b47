"""From recorded signals to the trials of a response: inputs, and outputs that may be the length or turn of a force."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.fit.signals import SignalSet, SignalTable, SignalTrial, load_signals
from labrun.fit.transfer.estimation import ResponseTrial
from labrun.fit.transfer.response import Hold
from labrun.store import is_recording, read_recording

_DEFINED = 0.25
"""A direction counts where the force is at least this share of its median in the trial."""


@dataclass(frozen=True, slots=True)
class Response:
    """The trials of one response, and the units of what went in and came out."""

    signals: SignalSet
    trials: tuple[ResponseTrial, ...]
    input_unit: str
    output_unit: str


def load_response(
    target: Path,
    given: SignalTable,
    output: SignalTable,
    *,
    where: Mapping[str, float | str] | None = None,
    from_s: float = 0.0,
    to_s: float | None = None,
    rate_hz: float | None = None,
) -> Response:
    """Load input and output of every trial that `where` admits.

    The magnitude of a force at rest is that of its noise, never zero. So what is loaded as magnitude is the force along
    the mean direction of the trial, with its sign: where there is force, it is the same, and where there is none,
    it is zero on average. A direction is left out where there is too little force to have one.

    Raises
    ------
    RequestError, FitError
        As `load_signals`; an input that is a vector; no sample between `from_s` and `to_s`.
    """
    if given.take != "value":
        raise RequestError(f"an input is one channel, not the {given.take} of two")
    wanted = {"input": given}
    if output.take == "value":
        wanted["output"] = output
    else:
        wanted["output"] = SignalTable(
            channel=output.channel,
            scale=output.scale,
            divide_by_m=output.divide_by_m,
            average=output.average,
        )
        wanted["side"] = SignalTable(
            channel=str(output.side_channel),
            scale=output.side_scale,
            divide_by_m=output.divide_by_m,
            average=output.average,
        )
    signals = load_signals(target, wanted, where=where, rate_hz=rate_hz)
    hold = _stated_hold(target, given.channel)
    same: dict[bytes, FloatArray] = {}
    trials = []
    for trial in signals.trials:
        column = same.setdefault(trial.values["input"].tobytes(), trial.values["input"])
        trials.append(_trial(trial, column, output, hold, from_s, to_s))
    unit = "deg" if output.take == "direction" else signals.units["output"]
    return Response(signals, tuple(trials), signals.units["input"], unit)


def _trial(
    trial: SignalTrial,
    given: FloatArray,
    output: SignalTable,
    hold: Hold | None,
    from_s: float,
    to_s: float | None,
) -> ResponseTrial:
    time_s, measured = trial.time_s, trial.values["output"]
    since = time_s - time_s[0]
    used = (since >= from_s) & (since <= (np.inf if to_s is None else to_s))
    averaged = 1
    if output.average == "cycle" and trial.period_s is not None:
        averaged = max(1, round(trial.period_s / trial.step_s))
    if output.take != "value":
        main, side = measured, trial.values["side"]
        if output.take == "magnitude":
            measured = _along(main, side, used)
            used &= ~_straddling(given, averaged)
        else:
            size = np.hypot(main, side)
            used &= size > _DEFINED * np.median(size[used]) if np.any(used) else False
            measured = np.degrees(np.unwrap(np.arctan2(side, main)))
            turns = np.round(np.median(measured[used]) / 360.0) if np.any(used) else 0.0
            measured = measured - 360.0 * turns
    if np.count_nonzero(used) < 10:
        raise FitError(
            f"{trial.label} has fewer than 10 samples to fit between {from_s:g} s and its end",
            hint="widen from_s and to_s",
        )
    return ResponseTrial(trial.label, time_s, given, measured, used, averaged, hold or jumps_or_runs(given))


def jumps_or_runs(given: FloatArray) -> Hold:
    """Return how an input of unknown kind runs between samples: one that only ever jumps is held."""
    moving = np.flatnonzero(np.diff(given) != 0.0)
    if len(moving) and (len(moving) == 1 or np.all(np.diff(moving) > 1)):
        return "constant"
    return "linear"


def _straddling(given: FloatArray, averaged: int) -> NDArray[np.bool_]:
    """Return the samples whose average is over a stroke that was not the same all along.

    The force within a stroke is far larger than its mean, and cancels over whole strokes of one amplitude only.
    """
    changed = np.concatenate([[0], np.cumsum(np.diff(given) != 0.0)])
    earlier = np.concatenate([np.full(min(averaged, len(given)), changed[0]), changed[:-averaged]])
    return np.asarray((changed != earlier[: len(given)]) & (averaged > 1))


def _along(main: FloatArray, side: FloatArray, used: NDArray[np.bool_]) -> FloatArray:
    size = np.hypot(main, side)
    strong = used & (size > 0.5 * np.max(size[used], initial=0.0))
    x, y = float(np.sum(main[strong])), float(np.sum(side[strong]))
    length = float(np.hypot(x, y)) or 1.0
    return (main * x + side * y) / length


def _stated_hold(target: Path, channel: str) -> Hold | None:
    if not is_recording(target):
        return None
    between = {info.name: info.between for info in read_recording(target).inputs}.get(channel)
    return "constant" if between == "hold" else "linear"
