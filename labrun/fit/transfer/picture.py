"""Pictures of fitted responses: measured and fitted, residual, step response and Bode plot."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from labrun.fit.figure import _LEFT, _MEASURED, _SIMULATED, _STYLE
from labrun.fit.transfer.fitting import TransferFit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST = 12
_SHOWN_SAMPLES = 300
_MOST_TURNS = 100


def draw_responses(fits: Mapping[str, TransferFit], title: str) -> "Figure":
    """Return a figure with one row a response."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(cast("Any", _STYLE)):
        figure = Figure(figsize=(11.5, 0.5 + 4.2 * len(fits)), dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(title, x=0.01, ha="left", fontsize=10)
        grid = figure.add_gridspec(2 * len(fits), 3, height_ratios=[2, 1] * len(fits), width_ratios=[2, 1, 1])
        for row, (name, fit) in enumerate(fits.items()):
            above, below = figure.add_subplot(grid[2 * row, 0]), figure.add_subplot(grid[2 * row + 1, 0])
            below.sharex(above)
            _overlay(above, below, name, fit)
            _step(figure.add_subplot(grid[2 * row : 2 * row + 2, 1]), fit)
            _bode(figure.add_subplot(grid[2 * row, 2]), figure.add_subplot(grid[2 * row + 1, 2]), fit)
    return figure


def _overlay(above: "Axes", below: "Axes", name: str, fit: TransferFit) -> None:
    unit = fit.transfer.output_unit
    pairs = list(zip(fit.trials, fit.point.simulated(fit.trials), strict=True))[:_MOST]
    if _is_dense(fit):
        pairs = pairs[:1]
    for index, (trial, simulated) in enumerate(pairs):
        first = index == 0
        time_s, used = trial.time_s, trial.used
        measured = np.where(used, trial.measured, np.nan)
        above.plot(time_s, measured, color=_MEASURED, lw=0.9, label="measured" if first else None)
        below.plot(time_s[used], (trial.measured - simulated)[used], color=_LEFT, lw=0.5, alpha=0.7)
    if _is_dense(fit):
        width_s = (
            (fit.trials[0].time_s[-1] - fit.trials[0].time_s[0]) * _SHOWN_SAMPLES / len(fit.trials[0].time_s)
        )
        above.set_xlim(fit.trials[0].time_s[0], fit.trials[0].time_s[0] + width_s)
    for index, (trial, simulated) in enumerate(pairs):
        begin = int(np.argmax(trial.used))  # before it, the answer from any initial state is anything
        above.plot(
            trial.time_s[begin:],
            simulated[begin:],
            color=_SIMULATED,
            lw=0.9,
            label=None if index else "fitted, with each offset",
        )
    shown = f", first {_MOST} of {len(fit.trials)} trials" if len(fit.trials) > _MOST else ""
    above.set_title(f"{name}: {len(fit.trials)} trials{shown}", loc="left", fontweight="bold")
    above.set_ylabel(f"{name}, {unit}")
    above.tick_params(labelbottom=False)
    above.legend(fontsize=7.5, loc="best")
    below.axhline(0.0, color="#7b8794", lw=0.6)
    below.set_ylabel(f"residual, {unit}")
    below.set_xlabel("time, s")
    below.set_title(f"RMS {fit.rmse:.3g} {unit}", loc="right", color=_LEFT, fontsize=7.5, pad=3)


def _is_dense(fit: TransferFit) -> bool:
    """Tell whether the output swings so often that a whole trial would be a block of ink."""
    measured = fit.trials[0].measured
    above = measured > np.mean(measured)
    return int(np.count_nonzero(above[1:] != above[:-1])) > 2 * _MOST_TURNS


def _step(axes: "Axes", fit: TransferFit) -> None:
    slowest = (
        1.0 / max(float(np.min(np.abs(fit.transfer.poles.real))), 1e-9)
        if fit.transfer.order
        else fit.trials[0].step_s
    )
    end_s = fit.transfer.dead_s + 6.0 * slowest
    time_s = np.linspace(0.0, end_s, 400)
    axes.plot(time_s, fit.transfer.step_response(time_s), color=_SIMULATED, lw=1.2)
    axes.set_title("answer to a unit step", loc="left")
    axes.set_xlabel("time, s")
    axes.set_ylabel(f"{fit.transfer.output_name or 'output'}, {fit.transfer.gain_unit}")


def _bode(gain: "Axes", phase: "Axes", fit: TransferFit) -> None:
    poles = np.abs(fit.transfer.poles) if fit.transfer.order else np.array([1.0])
    highest = np.pi / fit.trials[0].step_s
    omega = np.geomspace(
        min(0.05 * float(np.min(poles)), 1e-3 * highest), min(20.0 * float(np.max(poles)), highest), 400
    )
    answer = fit.transfer.frequency_response(omega)
    hertz = omega / (2.0 * np.pi)
    gain.loglog(hertz, np.abs(answer), color=_SIMULATED, lw=1.2)
    gain.set_title("Bode plot", loc="left")
    gain.set_ylabel(f"gain, {fit.transfer.gain_unit}")
    gain.tick_params(labelbottom=False)
    phase.semilogx(hertz, np.degrees(np.unwrap(np.angle(answer))), color=_SIMULATED, lw=1.2)
    phase.set_ylabel("phase, deg")
    phase.set_xlabel("frequency, Hz")
