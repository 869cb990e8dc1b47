"""Fitted transfer functions as a fit's result: estimates, what is left unexplained, what the data cannot tell, TOML."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import tomli_w

from labrun.arrays import FloatArray
from labrun.estimate import Estimate, rounded
from labrun.fit.resampling import correlation_length
from labrun.fit.result import Curve, FigureData, FitSummary, FittedData, Panel, Stack, TextTable
from labrun.fit.signals import SignalSet
from labrun.fit.transfer.fitting import TransferFit
from labrun.fit.transfer.transfer_function import TransferFunction

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
    said = list(findings)
    warned: list[str] = []
    for name, fit in fits.items():
        mine = _estimates(fit)
        estimates[name] = {f"{name}_{key}": estimate for key, estimate in mine.items()}
        table = fit.transfer.to_table()
        keys = {"gain": "gain", "lag": "lag_s", "dead_time": "dead_s"}
        table |= {f"{keys[key]}_ci95": list(one.ci95) for key, one in mine.items() if key in keys}
        written[name] = table
        said.append(f"{name} = {fit.transfer}")
        said += leftovers(fit, name, fit.transfer.output_unit)
        warned += warnings_of(fit, name)
        if any(trial.averaged > 1 for trial in fit.trials):
            said.append(
                f"{name}: the output was averaged over the gait cycle, and so was the fitted answer: gain, lag and "
                "dead time are the plant's, without the average"
            )
    count = sum(len(fit.trials) for fit in fits.values())
    title = f"{method} fitted to {signals.name}"
    return TransferSummary(
        method,
        method,
        FittedData(signals.name, signals.kind, count, signals.left_out),
        {key: one for mine in estimates.values() for key, one in mine.items()},
        rmse={name: fit.rmse for name, fit in fits.items()},
        rmse_units={name: fit.transfer.output_unit for name, fit in fits.items()},
        tables=(
            *(_roots(name, fit) for name, fit in fits.items() if not fit.transfer.is_first_order),
            *tables,
        ),
        findings=tuple(said),
        warnings=tuple(warned),
        details={"transfer": written},
        files={f"{method}.toml": f"# labrun fit: {title}\n\n{tomli_w.dumps(written)}"},
        figure_data=lambda: response_figure(fits, title),
        transfers={name: fit.transfer for name, fit in fits.items()},
        resampled={name: fit.resampled for name, fit in fits.items()},
        estimates=estimates,
    )


def _estimates(fit: TransferFit) -> dict[str, Estimate]:
    unit = fit.transfer.gain_unit
    found = {"gain": fit.estimate(lambda one: one.gain, unit)}
    if fit.transfer.is_first_order:
        found["lag"] = fit.estimate(lambda one: one.lag_s, "s")
    else:
        for power in range(1, fit.shape.zeros + 1):
            found[f"b{power}"] = fit.estimate(_above(power), f"{unit} {_seconds(power)}")
        for power in range(1, fit.shape.poles + 1):
            found[f"a{power}"] = fit.estimate(_below(power), _seconds(power))
    if fit.shape.dead_time:
        found["dead_time"] = fit.estimate(lambda one: one.dead_s, "s")
    return found


def _above(power: int) -> Callable[[TransferFunction], float]:
    return lambda one: one.numerator[-1 - power] if len(one.numerator) > power else 0.0


def _below(power: int) -> Callable[[TransferFunction], float]:
    return lambda one: one.denominator[-1 - power]


def _seconds(power: int) -> str:
    return "s" if power == 1 else f"s^{power}"


def _roots(name: str, fit: TransferFit) -> TextTable:
    rows = []
    for kind, roots in (("pole", fit.transfer.poles), ("zero", fit.transfer.zeros)):
        for root in roots:
            if root.imag < 0:
                continue
            size = abs(root)
            rows.append(
                (
                    kind,
                    f"{root.real:.4g}" + (f" ± {root.imag:.4g}j" if root.imag else ""),
                    f"{size / (2 * np.pi):.4g}",
                    f"{-root.real / size:.3g}" if size else "",
                )
            )
    return TextTable(f"{name}: poles and zeros", ("", "rad/s", "Hz", "damping ratio"), tuple(rows))


def leftovers(fit: TransferFit, name: str, unit: str) -> list[str]:
    """Return in words how large the residual is, whether it is white, and whether it still follows the input."""
    residuals = fit.residuals()
    spread = np.sqrt(np.mean(np.concatenate([_centred(t.measured[t.used]) for t in fit.trials]) ** 2))
    share = 100.0 * fit.rmse / spread if spread > 0 else 0.0
    step_s = fit.trials[0].step_s
    length = correlation_length(residuals)
    white = (
        "neighbouring samples of it are unrelated (white)"
        if length < 3.0
        else f"it stays correlated for {length * step_s:.2g} s: slow disturbance or dynamics that the model lacks"
    )
    found = [
        f"{name}: what is left is {fit.rmse:.3g} {unit} RMS, {share:.2g} % of the output's variation; {white}"
    ]
    strongest, limit = _input_correlation(fit, residuals, length)
    if strongest > limit:
        found.append(
            f"{name}: the residual still follows the input (correlation {strongest:.2f}, chance gives {limit:.2f}): "
            "more poles or zeros, or a nonlinearity, would explain more"
        )
    else:
        found.append(
            f"{name}: the residual does not follow the input (correlation {strongest:.2f}, chance {limit:.2f})"
        )
    return found


def warnings_of(fit: TransferFit, name: str) -> list[str]:
    """Return what to know before trusting the numbers."""
    said = []
    if fit.blocks:
        said.append(
            f"{name}: one trial: intervals rest on {fit.blocks} parts of it, not on independent repeats"
        )
    elif len(fit.trials) < 4:
        said.append(
            f"{name}: only {len(fit.trials)} trials: the intervals rest on their differences, and are wide"
        )
    step_s = fit.trials[0].step_s
    if fit.shape.dead_time and fit.transfer.dead_s < step_s:
        said.append(
            f"{name}: the dead time is below a sample ({step_s:.2g} s): it cannot be told from none at this rate"
        )
    for pole in fit.transfer.poles:
        slow_s = 1.0 / max(abs(pole), 1e-300)
        if slow_s < step_s:
            said.append(
                f"{name}: a time constant of {slow_s:.2g} s is below a sample ({step_s:.2g} s): not determined, and "
                "the intervals of the coefficients hold for this one only; fit a pole less"
            )
        said += [
            f"{name}: a pole and a zero nearly cancel at {abs(pole):.3g} rad/s: one of each fewer fits as well"
            for zero in fit.transfer.zeros
            if abs(pole - zero) < _CLOSE * abs(pole)
        ]
    spread = np.std(fit.draws, axis=0)
    if np.any(spread[: fit.shape.poles] > 1.0):
        said.append(
            f"{name}: the data do not determine {fit.shape.poles} poles: a coefficient of the denominator varies by "
            "more than its value between resamples; record a faster input, more trials, or fit fewer poles"
            if fit.shape.poles > 1
            else f"{name}: the data do not determine the lag: it varies by more than its value between resamples; "
            "record a faster input, or more trials"
        )
    return said + _told_apart(fit, name)


def _told_apart(fit: TransferFit, name: str) -> list[str]:
    """Return a warning where the data know the sum of lag and dead time much better than either."""
    if not (fit.transfer.is_first_order and fit.shape.dead_time and len(fit.draws)):
        return []
    lag = fit.estimate(lambda transfer: transfer.lag_s, "s")
    dead = fit.estimate(lambda transfer: transfer.dead_s, "s")
    if dead.ci95[0] > fit.trials[0].step_s and lag.ci95[1] < _LOOSE * lag.ci95[0]:
        return []
    value, low, high = rounded(fit.estimate(lambda transfer: transfer.lag_s + transfer.dead_s, "s"))
    return [
        f"{name}: the data hardly tell lag from dead time; their sum is {value} s ({low} ... {high}); a faster step, "
        "less averaging or more trials would tell them apart"
    ]


def _centred(values: FloatArray) -> FloatArray:
    return values - np.mean(values)


def _input_correlation(fit: TransferFit, residuals: list[FloatArray], length: float) -> tuple[float, float]:
    """Return the largest correlation of residual and earlier input, and what chance gives in 1 of 20 fits."""
    total = np.zeros(_LAGS)
    inputs = outputs = 0.0
    count = 0
    for trial, residual in zip(fit.trials, residuals, strict=True):
        given = _centred(trial.given[trial.used])
        rest = _centred(residual)
        lags = min(_LAGS, len(rest) // 2)
        for lag in range(lags):
            total[lag] += rest[lag:] @ given[: len(given) - lag]
        inputs += float(given @ given)
        outputs += float(rest @ rest)
        count += len(rest)
    if inputs == 0.0 or outputs == 0.0:
        return 0.0, 0.0
    largest = float(np.max(np.abs(total)) / np.sqrt(inputs * outputs))
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
    unit = fit.transfer.output_unit
    first = fit.trials[0]
    above = first.measured > np.mean(first.measured)
    # where the output swings so often that a whole trial would be a block of ink
    dense = int(np.count_nonzero(above[1:] != above[:-1])) > 2 * _MOST_TURNS
    pairs = list(zip(fit.trials, fit.point.simulated(fit.trials), strict=True))[: 1 if dense else _MOST]
    measured, fitted, residual = [], [], []
    for index, (trial, simulated) in enumerate(pairs):
        used = trial.used
        begin = int(np.argmax(used))  # before it, the answer from any initial state is anything
        shown = np.where(used, trial.measured, np.nan)
        measured.append(Curve(trial.time_s, shown, "measured", "" if index else "measured"))
        label = "" if index else "fitted, with each offset"
        fitted.append(Curve(trial.time_s[begin:], simulated[begin:], "fitted", label))
        residual.append(Curve(trial.time_s[used], (trial.measured - simulated)[used], "residual"))
    start_s, end_s = float(first.time_s[0]), float(first.time_s[-1])
    section = (start_s, start_s + (end_s - start_s) * _SHOWN_SAMPLES / len(first.time_s)) if dense else None
    number = f", first {_MOST} of {len(fit.trials)}" if len(fit.trials) > _MOST else ""
    upper = Panel(
        (*measured, *fitted),
        title=f"{name}: {len(fit.trials)} trials{number}",
        y_label=f"{name}, {unit}",
        x_range=section,
        height=2.0,
    )
    lower = Panel(
        tuple(residual),
        note=f"RMS {fit.rmse:.3g} {unit}",
        x_label="time, s",
        y_label=f"residual, {unit}",
        x_range=section,
        zero=True,
    )
    return Stack((upper, lower), width=1.6)


def _step_panel(fit: TransferFit) -> Panel:
    transfer = fit.transfer
    slowest_s = (
        1.0 / max(float(np.min(np.abs(transfer.poles.real))), 1e-9)
        if transfer.order
        else fit.trials[0].step_s
    )
    time_s = np.linspace(0.0, transfer.dead_s + 6.0 * slowest_s, 400)
    label = f"{transfer.output_name or 'output'}, {transfer.gain_unit}"
    curve = Curve(time_s, transfer.step_response(time_s))
    return Panel((curve,), title="answer to a unit step", x_label="time, s", y_label=label)


def _bode_panels(fit: TransferFit) -> tuple[Panel, Panel]:
    poles = np.abs(fit.transfer.poles) if fit.transfer.order else np.array([1.0])
    highest = np.pi / fit.trials[0].step_s
    lowest = min(0.05 * float(np.min(poles)), 1e-3 * highest)
    omega = np.geomspace(lowest, min(20.0 * float(np.max(poles)), highest), 400)
    answer = fit.transfer.frequency_response(omega)
    hertz = omega / (2.0 * np.pi)
    gain_label = f"gain, {fit.transfer.gain_unit}"
    return (
        Panel((Curve(hertz, np.abs(answer)),), title="Bode plot", y_label=gain_label, log="xy", height=1.3),
        Panel(
            (Curve(hertz, np.degrees(np.unwrap(np.angle(answer)))),),
            x_label="frequency, Hz",
            y_label="phase, deg",
            log="x",
        ),
    )
