"""Recorded traces: trials over each other in time, and folded onto one gait cycle."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from labrun.arrays import FloatArray
from labrun.report.data import RunView
from labrun.report.style import COLOURS, FAINT, zero_line
from labrun.store import TrialOutcome

_MOST_TRACES = 15
_BINS = 60
_GAP = 20.0
"""Times the usual step between samples: a longer one is no line."""
_TRAVELS = 0.5
"""Way in a cycle, in units of the swing about it, from which a channel travels."""
_PHASES = (np.arange(_BINS) + 0.5) / _BINS


def draw_traces(axes: Axes, view: RunView, trials: Sequence[TrialOutcome], channel: str) -> None:
    """Draw trials over each other; what the objectives leave out is shaded."""
    shown = trials[:_MOST_TRACES]
    alpha = float(np.clip(3.0 / max(len(shown), 1), 0.25, 0.8))
    end = 0.0
    for trial in shown:
        trace = view.trace(trial, channel)
        if trace is not None:
            axes.plot(*_broken(*trace), color=COLOURS[0], linewidth=0.7, alpha=alpha)
            end = max(end, trial.duration_s)
    first = shown[0]
    if first.period_s is not None and first.discard_cycles:
        axes.axvspan(0, first.discard_cycles * first.period_s, color=FAINT, alpha=0.55, linewidth=0, zorder=0)
        axes.text(
            0.5 * first.discard_cycles * first.period_s,
            0.985,
            "not counted",
            transform=axes.get_xaxis_transform(),
            ha="center",
            va="top",
            fontsize=7.5,
            color="#666666",
        )
    axes.set_xlim(0, end or 1.0)
    axes.set_xlabel("time since start of motion (s)")
    axes.set_ylabel(view.trace_label)
    zero_line(axes)


def _broken(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a trace that is interrupted where samples are missing: of some trials only some cycles are kept."""
    steps = np.diff(time_s)
    if not len(steps):
        return time_s, values
    gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    return np.insert(time_s, gaps, np.nan), np.insert(values, gaps, np.nan)


def cycles_of(view: RunView, trials: Sequence[TrialOutcome], channel: str) -> FloatArray | None:
    """Return the mean gait cycle of each trial, (trials, 60); None if the motion has no cycles, or the channel travels.

    A position that goes on from cycle to cycle has no mean cycle: its way over time says all there is.
    """
    folded = [cycle for trial in trials if (cycle := folded_cycle(view, trial, channel)) is not None]
    if not folded or any(_travels(view, trial, channel) for trial in trials):
        return None
    return np.vstack(folded)


def _travels(view: RunView, trial: TrialOutcome, channel: str) -> bool:
    """Tell whether most of what a channel does in a cycle is that it goes on, whole cycles at a time."""
    trace = view.trace(trial, channel)
    if trace is None or trial.period_s is None:
        return False
    time_s, values = trace
    counted = time_s >= trial.discard_cycles * trial.period_s
    time_s, values = time_s[counted], values[counted]
    cycles = int((time_s[-1] - time_s[0]) / trial.period_s * (1.0 + 1e-6)) if len(time_s) > 1 else 0
    if not cycles:
        return False
    after_s = time_s[0] + cycles * trial.period_s
    way = float(np.interp(after_s, time_s, values) - values[0]) / cycles
    swing = np.ptp(values - way * (time_s - time_s[0]) / trial.period_s)
    return abs(way) > _TRAVELS * float(swing)


def draw_cycle(axes: Axes, cycles: FloatArray) -> None:
    """Draw the mean gait cycle of trials (trials, 60), with the spread between them."""
    mean = cycles.mean(axis=0)
    if len(cycles) > 1:
        spread = cycles.std(axis=0, ddof=1)
        axes.fill_between(_PHASES, mean - spread, mean + spread, color=COLOURS[0], alpha=0.22, linewidth=0)
    axes.plot(_PHASES, mean, color=COLOURS[0])
    level = float(mean.mean())
    axes.axhline(level, color=COLOURS[1], linewidth=1.1, linestyle=(0, (4, 2)))
    axes.annotate(
        f"mean {level:.3g}",
        (1.0, level),
        xytext=(-2, 3),
        textcoords="offset points",
        ha="right",
        va="bottom",
        fontsize=8,
        color=COLOURS[1],
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0},
    )
    axes.set_xlim(0, 1)
    axes.set_xlabel("phase of the gait cycle")
    axes.tick_params(labelleft=True)
    zero_line(axes)


def folded_cycle(view: RunView, trial: TrialOutcome, channel: str) -> FloatArray | None:
    """Return the mean cycle of a trial, in bins of the phase, shape (60,); None without cycles or samples.

    Bins that no sample falls into (a sensor slower than the gait's bins) are interpolated around the cycle.
    """
    trace = view.trace(trial, channel)
    if trace is None or trial.period_s is None:
        return None
    time_s, values = trace
    counted = time_s >= trial.discard_cycles * trial.period_s
    if np.count_nonzero(counted) < 4:
        return None
    phase = np.mod(time_s[counted] / trial.period_s, 1.0)
    # No finer than the sensor: bins of a sample or two would show noise as if it belonged to the gait.
    a_cycle = trial.period_s / float(np.median(np.diff(time_s[counted])))
    number = int(np.clip(a_cycle / 1.5, 6, _BINS))
    bins = np.minimum((phase * number).astype(int), number - 1)
    counts = np.bincount(bins, minlength=number)
    sums = np.bincount(bins, weights=values[counted], minlength=number)
    filled = np.flatnonzero(counts)
    means = sums[filled] / counts[filled]
    return np.asarray(np.interp(_PHASES, (filled + 0.5) / number, means, period=1.0))
