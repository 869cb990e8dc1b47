"""Figure: reference trials over the run, with the straight line through them and its interval."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labrun.report.data import RunView
from labrun.report.statistics import Drift
from labrun.report.style import COLOURS, SOFT, new_figure
from labrun.report.svg import as_svg
from labrun.report.text import slope_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FloatArray = NDArray[np.float64]

MOST_PANELS = 4


def draw_drift(view: RunView, found: Sequence[Drift]) -> bytes:
    """Return the figure as SVG, one panel an objective, at most `MOST_PANELS`.

    Parameters
    ----------
    view
        The run.
    found
        Its drift, from `labrun.report.statistics.drift`.
    """
    shown = found[:MOST_PANELS]
    with new_figure(7.4, 0.5 + 1.75 * len(shown)) as figure:
        rows: Any = figure.subplots(len(shown), 1, sharex=True, squeeze=False)
        for axes, item in zip(rows[:, 0], shown, strict=True):
            _panel(axes, view, item)
        rows[-1, 0].set_xlabel("bench time since the first trial (h)")
        return as_svg(figure)


def reference_values(view: RunView, objective: str) -> tuple[FloatArray, FloatArray]:
    """Return hours since the run's first trial and values of the accepted reference trials, both (n,)."""
    start_s = view.run.outcomes[0].started_s
    trials = [
        outcome
        for outcome in view.run.outcomes
        if outcome.role == "reference" and outcome.status == "done" and objective in outcome.objectives
    ]
    hours = np.array([(outcome.started_s - start_s) / 3600 for outcome in trials])
    return hours, np.array([outcome.objectives[objective] for outcome in trials])


def line_band(hours: FloatArray, values: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares line and the half-width of its 95 % confidence band.

    Parameters
    ----------
    hours, values : (n,)
        At least three points that are not all at one time.
    at : (m,)
        Where line and band are wanted.

    Returns
    -------
    line, half : (m,)
        Working-Hotelling is not used: the band holds at each point, not for the line as a whole.
    """
    from scipy.stats import t

    centre, n = hours.mean(), len(hours)
    square = float(((hours - centre) ** 2).sum())
    slope = float(((hours - centre) * values).sum()) / square
    residual = values - values.mean() - slope * (hours - centre)
    sd = math.sqrt(float(residual @ residual) / (n - 2))
    half = float(t.ppf(0.975, n - 2)) * sd * np.sqrt(1 / n + (at - centre) ** 2 / square)
    return values.mean() + slope * (at - centre), half


def _panel(axes: "Axes", view: RunView, item: Drift) -> None:
    hours, values = reference_values(view, item.objective)
    at = np.linspace(hours.min(), hours.max(), 60)
    line, half = line_band(hours, values, at)
    colour = COLOURS[1] if item.visible else COLOURS[0]
    axes.fill_between(at, line - half, line + half, color=colour, alpha=0.15, linewidth=0)
    axes.plot(at, line, color=colour)
    axes.plot(hours, values, "o", color=SOFT, markersize=4, markeredgewidth=0)
    axes.set_ylabel(f"{item.objective} ({item.unit})" if item.unit else item.objective)
    axes.set_title(f"slope {slope_words(item.slope_per_h, item.ci95, item.unit)}")
