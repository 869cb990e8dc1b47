"""The fits fopdt (gain, lag, dead time from steps) and transfer-function: signals they take, and what they say."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import BaseModel, Field, NonNegativeFloat, PositiveFloat, model_validator

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.estimate import Estimate, rounded
from labrun.fit.dataset import DataCheck, unchecked
from labrun.fit.method import FitJob, WithSettings
from labrun.fit.result import Curve, FigureData, FitSummary, FittedData, Panel, Stack, TextTable
from labrun.fit.signals import SignalSet, SignalTable, SignalTrial, load_signals
from labrun.fit.transfer.fitting import (
    STARTS,
    Initial,
    ResponseTrial,
    Shape,
    TransferFit,
    compare_orders,
    fit_transfer,
)
from labrun.fit.transfer.transfer_function import Hold, TransferFunction
from labrun.fit.uncertainty import correlation_length
from labrun.store import is_recording, read_recording
from labrun.toml import Keys

_CLOSE = 0.1
_LOOSE = 3.0
"""A lag whose interval spans more than this factor is not known by itself."""
_LAGS = 100


@dataclass(frozen=True, slots=True)
class TransferSummary(FitSummary):
    """A `FitSummary` with what was found by response.

    Attributes
    ----------
    resampled
        Others that the data do not rule out.
    estimates
        Which of `parameters` are whose.
    """

    transfers: Mapping[str, TransferFunction] = field(default_factory=dict)
    resampled: Mapping[str, Sequence[TransferFunction]] = field(default_factory=dict)
    estimates: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)

    @property
    def transfer(self) -> TransferFunction:
        """The one transfer function; the first of several."""
        return next(iter(self.transfers.values()))


def summarise(
    method: str,
    fits: Mapping[str, TransferFit],
    signals: SignalSet,
    *,
    tables: Sequence[TextTable] = (),
    findings: Sequence[str] = (),
) -> TransferSummary:
    """Return the result of a fit of one or more responses."""
    estimates: dict[str, dict[str, Estimate]] = {}
    written = {}
    messages = list(findings)
    warned: list[str] = []
    for name, fit in fits.items():
        mine = _estimates(fit)
        estimates[name] = {f"{name}_{key}": estimate for key, estimate in mine.items()}
        table = fit.transfer.to_table()
        keys = {"gain": "gain", "lag": "lag_s", "dead_time": "dead_s"}
        table |= {f"{keys[key]}_ci95": list(estimate.ci95) for key, estimate in mine.items() if key in keys}
        written[name] = table
        messages.append(f"{name} = {fit.transfer}")
        messages += leftovers(fit, name, fit.transfer.output_unit)
        warned += warnings_of(fit, name)
        if any(trial.averaged > 1 for trial in fit.trials):
            messages.append(
                f"{name}: the output was averaged over the gait cycle, and so was the fitted answer: gain, lag and "
                "dead time are the plant's, without the average"
            )
    count = sum(len(fit.trials) for fit in fits.values())
    title = f"{method} fitted to {signals.name}"
    return TransferSummary(
        method,
        method,
        FittedData(signals.name, signals.kind, count, signals.left_out),
        {key: estimate for mine in estimates.values() for key, estimate in mine.items()},
        rmse={name: fit.rmse for name, fit in fits.items()},
        rmse_units={name: fit.transfer.output_unit for name, fit in fits.items()},
        tables=(
            *(_roots(name, fit) for name, fit in fits.items() if not fit.transfer.is_first_order),
            *tables,
        ),
        findings=tuple(messages),
        warnings=tuple(warned),
        details={"transfer": written},
        files={f"{method}.toml": f"# labrun fit: {title}\n\n{tomli_w.dumps(written)}"},
        figure_data=lambda: response_figure(fits, title),
        transfers={name: fit.transfer for name, fit in fits.items()},
        resampled={name: fit.resampled for name, fit in fits.items()},
        estimates=estimates,
    )


def _estimates(fit: TransferFit) -> dict[str, Estimate]:
    unit, first_order = fit.transfer.gain_unit, fit.transfer.is_first_order
    estimates = {"gain": fit.estimate(lambda transfer: transfer.gain, unit)}
    if first_order:
        estimates["lag"] = fit.estimate(lambda transfer: transfer.lag_s, "s")
    if fit.lag_is_open:
        estimates = {key: _open_ended(estimate) for key, estimate in estimates.items()}
        estimates["gain_over_lag"] = _gain_over_lag(fit)
    for letter, above, most in (("b", f"{unit} ", fit.shape.zeros), ("a", "", fit.shape.poles)):
        for power in range(1, 0 if first_order else most + 1):
            seconds = "s" if power == 1 else f"s^{power}"
            estimates[f"{letter}{power}"] = fit.estimate(_coefficient(letter, power), above + seconds)
    if fit.shape.dead_time:
        estimates["dead_time"] = fit.estimate(lambda transfer: transfer.dead_s, "s")
    return estimates


def _open_ended(estimate: Estimate) -> Estimate:
    """Return an estimate whose interval ends at infinity on the side away from zero."""
    low, high = estimate.ci95
    return replace(estimate, ci95=(low, np.inf) if estimate.value > 0 else (-np.inf, high))


def _gain_over_lag(fit: TransferFit) -> Estimate:
    """Return the slope of the answer to a unit step, which a record much shorter than the lag does tell."""
    return fit.estimate(lambda transfer: transfer.gain / transfer.lag_s, f"{fit.transfer.gain_unit}/s")


def _coefficient(letter: str, power: int) -> Callable[[TransferFunction], float]:
    """Return what reads a coefficient of numerator ("b") or denominator ("a"); those it does not have are 0."""

    def read(transfer: TransferFunction) -> float:
        row = transfer.numerator if letter == "b" else transfer.denominator
        return row[-1 - power] if len(row) > power else 0.0

    return read


def _roots(name: str, fit: TransferFit) -> TextTable:
    rows = []
    for kind, roots in (("pole", fit.transfer.poles), ("zero", fit.transfer.zeros)):
        for root in roots[roots.imag >= 0]:
            size, message = abs(root), f"{root.real:.4g}" + (f" ± {root.imag:.4g}j" if root.imag else "")
            rows.append(
                (kind, message, f"{size / (2 * np.pi):.4g}", f"{-root.real / size:.3g}" if size else "")
            )
    return TextTable(f"{name}: poles and zeros", ("", "rad/s", "Hz", "damping ratio"), tuple(rows))


def leftovers(fit: TransferFit, name: str, unit: str) -> list[str]:
    """Return in words how large the residual is, whether it is white, and whether it still follows the input."""
    residuals = fit.residuals()
    measured = [trial.measured[trial.used] for trial in fit.trials]
    spread = np.sqrt(np.mean(np.concatenate([values - np.mean(values) for values in measured]) ** 2))
    share = 100.0 * fit.rmse / spread if spread > 0 else 0.0
    length = correlation_length(residuals)
    white = "neighbouring samples of it are unrelated (white)"
    if length >= 3.0:
        lasting_s = length * fit.trials[0].step_s
        white = (
            f"it stays correlated for {lasting_s:.2g} s: slow disturbance or dynamics that the model lacks"
        )
    strongest, limit = _input_correlation(fit, residuals, length)
    follows = (
        f"still follows the input (correlation {strongest:.2f}, chance gives {limit:.2f}): "
        "more poles or zeros, or a nonlinearity, would explain more"
        if strongest > limit
        else f"does not follow the input (correlation {strongest:.2f}, chance {limit:.2f})"
    )
    return [
        f"{name}: what is left is {fit.rmse:.3g} {unit} RMS, {share:.2g} % of the output's variation; {white}",
        f"{name}: the residual {follows}",
    ]


def warnings_of(fit: TransferFit, name: str) -> list[str]:
    """Return what to know before trusting the numbers."""
    messages, step_s, poles = [], fit.trials[0].step_s, fit.shape.poles
    if fit.blocks:
        messages.append(f"one trial: intervals rest on {fit.blocks} parts of it, not on independent repeats")
    elif len(fit.trials) < 4:
        messages.append(
            f"only {len(fit.trials)} trials: the intervals rest on their differences, and are wide"
        )
    if fit.shape.dead_time and fit.transfer.dead_s < step_s:
        messages.append(
            f"the dead time is below a sample ({step_s:.2g} s): it is not distinguishable from zero at this rate"
        )
    for pole in fit.transfer.poles:
        slow_s = 1.0 / max(abs(pole), 1e-300)
        if slow_s < step_s:
            messages.append(
                f"a time constant of {slow_s:.2g} s is below a sample ({step_s:.2g} s): not determined, and "
                "the intervals of the coefficients hold for this one only; fit a pole less"
            )
        messages += [
            f"a pole and a zero nearly cancel at {abs(pole):.3g} rad/s: one of each fewer fits as well"
            for zero in fit.transfer.zeros
            if abs(pole - zero) < _CLOSE * abs(pole)
        ]
    messages += _bounds_reached(fit)
    if not fit.lag_is_open and np.any(np.std(fit.draws, axis=0)[:poles] > 1.0):
        messages.append(
            f"the data do not determine {poles} poles: a coefficient of the denominator varies by "
            "more than its value between resamples; record a faster input, more trials, or fit fewer poles"
            if poles > 1
            else "the data do not determine the lag: it varies by more than its value between resamples; "
            "record a faster input, or more trials"
        )
    return [f"{name}: {message}" for message in messages + _told_apart(fit)]


def _bounds_reached(fit: TransferFit) -> list[str]:
    """Return a warning for each number that the record bounds on one side only."""
    messages, reached, poles = [], fit.upper_bounds_reached, fit.shape.poles
    if fit.lag_is_open:
        least = fit.estimate(lambda transfer: transfer.lag_s, "s").ci95[0]
        slope, low, high = rounded(_gain_over_lag(fit))
        messages.append(
            f"the record is too short to tell the lag: {fit.record_s:.3g} s tell that it is at least {least:.3g} s; "
            f"gain/lag = {slope} ({low} ... {high}) {fit.transfer.gain_unit}/s is what it tells; record longer after "
            "the step"
        )
    elif np.any(reached[:poles]):
        messages.append(
            f"a coefficient of the denominator ended at its upper bound: the record of {fit.record_s:.3g} s is too "
            "short to tell the slowest time constant; record longer, or fit a pole less"
        )
    if fit.shape.dead_time and reached[poles]:
        messages.append(
            f"the dead time ended at its upper bound of {fit.transfer.dead_s:.3g} s, a share of the record's "
            f"{fit.record_s:.3g} s: record longer, or check that this output answers this input"
        )
    return messages


def _told_apart(fit: TransferFit) -> list[str]:
    """Return a warning where the data know the sum of lag and dead time much better than either."""
    if not (fit.shape.is_first_order and fit.shape.dead_time) or fit.lag_is_open:
        return []
    lag = fit.estimate(lambda transfer: transfer.lag_s, "s")
    dead = fit.estimate(lambda transfer: transfer.dead_s, "s")
    if dead.ci95[0] > fit.trials[0].step_s and lag.ci95[1] < _LOOSE * lag.ci95[0]:
        return []
    value, low, high = rounded(fit.estimate(lambda transfer: transfer.lag_s + transfer.dead_s, "s"))
    return [
        f"the data hardly tell lag from dead time; their sum is {value} s ({low} ... {high}); a faster step, "
        "less averaging or more trials would tell them apart"
    ]


def _input_correlation(fit: TransferFit, residuals: list[FloatArray], length: float) -> tuple[float, float]:
    """Return the largest correlation of residual and earlier input, and what chance gives in 1 of 20 fits."""
    total = np.zeros(_LAGS)
    inputs = outputs = 0.0
    for trial, residual in zip(fit.trials, residuals, strict=True):
        given, rest = (values - np.mean(values) for values in (trial.given[trial.used], residual))
        for lag in range(min(_LAGS, len(rest) // 2)):
            total[lag] += rest[lag:] @ given[: len(given) - lag]
        inputs += float(given @ given)
        outputs += float(rest @ rest)
    if inputs == 0.0 or outputs == 0.0:
        return 0.0, 0.0
    largest = float(np.max(np.abs(total)) / np.sqrt(inputs * outputs))
    count = sum(len(residual) for residual in residuals)
    return largest, float(min(3.5 * np.sqrt(max(length, 1.0) / count), 1.0))


_MOST = 12
_SHOWN_SAMPLES = 300
_MOST_TURNS = 100


def response_figure(fits: Mapping[str, TransferFit], title: str) -> FigureData:
    """Return a row for each response: measured and fitted with the residual, the step response, the Bode plot."""
    rows = tuple(
        (_overlay(name, fit), Stack((_step_panel(fit),)), Stack(_bode_panels(fit)))
        for name, fit in fits.items()
    )
    return FigureData(title, rows, row_height_in=4.2)


def _overlay(name: str, fit: TransferFit) -> Stack:
    unit, first = fit.transfer.output_unit, fit.trials[0]
    above = first.measured > np.mean(first.measured)
    # where the output swings so often that a whole trial would be a block of ink
    dense = int(np.count_nonzero(above[1:] != above[:-1])) > 2 * _MOST_TURNS
    pairs = list(zip(fit.trials, fit.point.simulated(fit.trials), strict=True))[: 1 if dense else _MOST]
    measured, fitted, residual = [], [], []
    for index, (trial, simulated) in enumerate(pairs):
        used = trial.used
        begin = int(np.argmax(used))  # before it, the answer from any initial state is anything
        labels = ("", "") if index else ("measured", "fitted, with each offset")
        measured.append(Curve(trial.time_s, np.where(used, trial.measured, np.nan), "measured", labels[0]))
        fitted.append(Curve(trial.time_s[begin:], simulated[begin:], "fitted", labels[1]))
        residual.append(Curve(trial.time_s[used], (trial.measured - simulated)[used], "residual"))
    start_s, end_s = float(first.time_s[0]), float(first.time_s[-1])
    section = (start_s, start_s + (end_s - start_s) * _SHOWN_SAMPLES / len(first.time_s)) if dense else None
    number = f", first {_MOST} of {len(fit.trials)}" if len(fit.trials) > _MOST else ""
    upper = Panel(
        (*measured, *fitted), title=f"{name}: {len(fit.trials)} trials{number}", y_label=f"{name}, {unit}",
        x_range=section, height=2.0,
    )  # fmt: skip
    lower = Panel(
        tuple(residual), note=f"RMS {fit.rmse:.3g} {unit}", x_label="time, s", y_label=f"residual, {unit}",
        x_range=section, zero=True,
    )  # fmt: skip
    return Stack((upper, lower), width=1.6)


def _step_panel(fit: TransferFit) -> Panel:
    transfer = fit.transfer
    slowest_s = fit.trials[0].step_s
    if transfer.order:
        slowest_s = 1.0 / max(float(np.min(np.abs(transfer.poles.real))), 1e-9)
    time_s = np.linspace(0.0, transfer.dead_s + 6.0 * slowest_s, 400)
    label = f"{transfer.output_name or 'output'}, {transfer.gain_unit}"
    curve = Curve(time_s, transfer.step_response(time_s))
    return Panel((curve,), title="answer to a unit step", x_label="time, s", y_label=label)


def _bode_panels(fit: TransferFit) -> tuple[Panel, Panel]:
    poles = np.abs(fit.transfer.poles) if fit.transfer.order else np.array([1.0])
    highest = np.pi / fit.trials[0].step_s
    lowest = min(0.05 * float(np.min(poles)), 1e-3 * highest)
    omega = np.geomspace(lowest, min(20.0 * float(np.max(poles)), highest), 400)
    answer, hertz = fit.transfer.frequency_response(omega), omega / (2.0 * np.pi)
    size, phase = Curve(hertz, np.abs(answer)), Curve(hertz, np.degrees(np.unwrap(np.angle(answer))))
    gain_label = f"gain, {fit.transfer.gain_unit}"
    return (
        Panel((size,), title="Bode plot", y_label=gain_label, log="xy", height=1.3),
        Panel((phase,), x_label="frequency, Hz", y_label="phase, deg", log="x"),
    )


_DEFINED = 0.25
"""A direction counts where the force is at least this share of its median in the trial."""


class ResponseTable(Keys):
    """One response: which trials, from what to what, and when.

    `input_unit` is for an input whose unit nothing states, as a named part of a gait.
    """

    input: SignalTable
    output: SignalTable
    input_unit: str | None = None
    where: dict[str, float | str] = Field(default_factory=dict)
    from_s: NonNegativeFloat = 0.0
    to_s: PositiveFloat | None = None


def load_response(
    target: Path, table: ResponseTable, check: DataCheck = unchecked
) -> tuple[SignalSet, list[ResponseTrial]]:
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
    signals = load_signals(target, wanted, where=table.where, check=check)
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


class FopdtSettings(Keys):
    """Keys of the fit: a response by each name."""

    responses: dict[str, ResponseTable] = Field(min_length=1)


class FopdtFit(WithSettings[FopdtSettings]):
    """Every response as ``gain exp(-dead_time s)/(lag s + 1)``, each by itself."""

    Settings: ClassVar[type[BaseModel]] = FopdtSettings

    def __call__(self, job: FitJob) -> TransferSummary:
        """Fit every response."""
        fits, signals = _fitted(job, self._settings.responses, Shape(1, 0))
        return summarise("fopdt", fits, signals)


class TransferFunctionSettings(Keys):
    """Keys of the fit: order, dead time, and either `input` and `output` or `responses`, as fopdt has them."""

    poles: int = Field(default=2, ge=1, le=8)
    zeros: int = Field(default=0, ge=0)
    dead_time: bool = False
    initial: Initial = "free"
    compare: bool = True
    input: SignalTable | None = None
    input_unit: str | None = None
    output: SignalTable | None = None
    where: dict[str, float | str] = Field(default_factory=dict)
    from_s: NonNegativeFloat = 0.0
    to_s: PositiveFloat | None = None
    responses: dict[str, ResponseTable] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _proper(self) -> Self:
        if self.zeros > self.poles:
            raise ValueError(f"zeros = {self.zeros} must not be more than poles = {self.poles}")
        return self


class TransferFunctionFit(WithSettings[TransferFunctionSettings]):
    """Output error in continuous time, see `labrun.fit.transfer.fitting`."""

    Settings: ClassVar[type[BaseModel]] = TransferFunctionSettings

    def __call__(self, job: FitJob) -> TransferSummary:
        """Fit every response, each by itself, and compare neighbouring orders."""
        chosen = self._settings
        shape = Shape(chosen.poles, chosen.zeros, chosen.dead_time, initial=chosen.initial)
        fits, signals = _fitted(job, self._responses(job), shape)
        tables, findings = [], []
        for name, fit in fits.items() if chosen.compare else ():
            job.note(f"comparing other orders for {name}")
            compared, messages = compare_orders(fit, name)
            tables.append(compared)
            findings += messages
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
        signals, trials = load_response(job.target, table, job.check)
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
