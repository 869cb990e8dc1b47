"""What the figure of fitted responses shows."""

from collections.abc import Mapping

import numpy as np

from labrun.fit.figure import Curve, FigureData, Panel, Stack
from labrun.fit.transfer.fitting import TransferFit

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
