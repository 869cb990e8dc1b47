"""The fits ``fopdt`` (gain, lag and dead time from steps) and ``transfer-function``, and the signals they take."""

from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat, model_validator

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.fit.method import FitJob, WithSettings
from labrun.fit.signals import SignalSet, SignalTable, SignalTrial, load_signals
from labrun.fit.transfer.estimation import Initial, ResponseTrial, Shape
from labrun.fit.transfer.fitting import STARTS, TransferFit, compare_orders, fit_transfer
from labrun.fit.transfer.response import Hold
from labrun.fit.transfer.summary import TransferSummary, summarise
from labrun.store import is_recording, read_recording

_DEFINED = 0.25
"""A direction counts where the force is at least this share of its median in the trial."""


class _Keys(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ResponseTable(_Keys):
    """One response: which trials, from what to what, and when.

    `input_unit` is for an input whose unit nothing states, as a named part of a gait.
    """

    input: SignalTable
    output: SignalTable
    input_unit: str | None = None
    where: dict[str, float | str] = {}
    from_s: NonNegativeFloat = 0.0
    to_s: PositiveFloat | None = None


def load_response(target: Path, table: ResponseTable) -> tuple[SignalSet, list[ResponseTrial]]:
    """Load input and output of every trial that the table admits.

    The magnitude of a force at rest is that of its noise, never zero. So what is loaded as magnitude is the force along
    the mean direction of the trial, with its sign: where there is force, it is the same, and where there is none, it is
    zero on average. A direction is left out where there is too little force to have one. Raises RequestError, FitError:
    as `load_signals`; an input that is a vector; no sample between `from_s` and `to_s`.
    """
    given, output = table.input, table.output
    if given.take != "value":
        raise RequestError(f"an input is one channel, not the {given.take} of two")
    along = output.model_copy(update={"take": "value", "side_channel": None})
    wanted = {"input": given, "output": along}
    if output.take != "value":
        wanted["side"] = along.model_copy(update={"channel": output.side_channel, "scale": output.side_scale})
    signals = load_signals(target, wanted, where=table.where)
    hold = _stated_hold(target, given.channel)
    same: dict[bytes, FloatArray] = {}
    trials = []
    for trial in signals.trials:
        column = same.setdefault(trial.values["input"].tobytes(), trial.values["input"])
        trials.append(_trial(trial, column, table, hold))
    return signals, trials


def _trial(trial: SignalTrial, given: FloatArray, table: ResponseTable, hold: Hold | None) -> ResponseTrial:
    time_s, measured, output = trial.time_s, trial.values["output"], table.output
    since = time_s - time_s[0]
    used = (since >= table.from_s) & (since <= (np.inf if table.to_s is None else table.to_s))
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
            f"{trial.label} has fewer than 10 samples to fit between {table.from_s:g} s and its end",
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


class FopdtSettings(_Keys):
    """Keys of the fit: a response by each name."""

    responses: dict[str, ResponseTable] = Field(min_length=1)


class FopdtFit(WithSettings[FopdtSettings]):
    """Every response as ``gain exp(-dead_time s)/(lag s + 1)``, each by itself."""

    Settings: ClassVar[type[BaseModel]] = FopdtSettings

    def __call__(self, job: FitJob) -> TransferSummary:
        """Fit every response."""
        fits, signals = _fitted(job, self._settings.responses, Shape(1, 0))
        return summarise("fopdt", fits, signals)


class TransferFunctionSettings(_Keys):
    """Keys of the fit: order, dead time, and either `input` and `output` or `responses`, as fopdt has them."""

    poles: int = Field(default=2, ge=1, le=8)
    zeros: int = Field(default=0, ge=0)
    dead_time: bool = False
    initial: Initial = "free"
    compare: bool = True
    input: SignalTable | None = None
    input_unit: str | None = None
    output: SignalTable | None = None
    where: dict[str, float | str] = {}
    from_s: NonNegativeFloat = 0.0
    to_s: PositiveFloat | None = None
    responses: dict[str, ResponseTable] = {}

    @model_validator(mode="after")
    def _proper(self) -> Self:
        if self.zeros > self.poles:
            raise ValueError(f"zeros = {self.zeros} must not be more than poles = {self.poles}")
        return self


class TransferFunctionFit(WithSettings[TransferFunctionSettings]):
    """Output error in continuous time, see `labrun.fit.transfer.estimation`."""

    Settings: ClassVar[type[BaseModel]] = TransferFunctionSettings

    def __call__(self, job: FitJob) -> TransferSummary:
        """Fit every response, each by itself, and compare neighbouring orders."""
        chosen = self._settings
        shape = Shape(chosen.poles, chosen.zeros, chosen.dead_time, initial=chosen.initial)
        fits, signals = _fitted(job, self._responses(job), shape)
        tables, findings = [], []
        for name, fit in fits.items() if chosen.compare else ():
            job.note(f"comparing other orders for {name}")
            compared, told = compare_orders(fit, name)
            tables.append(compared)
            findings += told
        return summarise("transfer-function", fits, signals, tables=tables, findings=findings)

    def _responses(self, job: FitJob) -> dict[str, ResponseTable]:
        chosen = self._settings
        if chosen.input is not None and chosen.output is not None:
            keys = {key: getattr(chosen, key) for key in ResponseTable.model_fields}
            return {chosen.output.channel.rpartition(".")[2]: ResponseTable(**keys)}
        if not chosen.responses:
            raise RequestError(
                f"which channels of {job.target} are input and output?",
                hint="--set input=CHANNEL --set output=CHANNEL, or [fit.settings.responses.NAME] in the experiment",
            )
        return chosen.responses


def _fitted(
    job: FitJob, responses: dict[str, ResponseTable], shape: Shape
) -> tuple[dict[str, TransferFit], SignalSet]:
    """Return the fit of every response, and the signals of the last."""
    fits = {}
    for name, table in responses.items():
        job.note(f"fitting {name}")
        signals, trials = load_response(job.target, table)
        fits[name] = fit_transfer(
            trials,
            shape,
            rng=job.rng,
            starts=job.starts or STARTS,
            input_name=table.input.channel,
            output_name=name,
            input_unit=table.input_unit or signals.units["input"],
            output_unit="deg" if table.output.take == "direction" else signals.units["output"],
        )
    return fits, signals
