"""Figure: how far single trials of a condition lie apart, against the condition's mean."""

import math
from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.report.data import RunView
from labrun.report.statistics import Repeatability
from labrun.report.style import COLOURS, SOFT, new_figure
from labrun.report.svg import as_svg

FloatArray = NDArray[np.float64]


def spreads(view: RunView, objective: str) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Return mean, standard deviation and number of trials of every condition that was repeated, each (n,)."""
    points = [point for point in view.points(objective) if len(point.values) > 1]
    return (
        np.array([point.mean for point in points]),
        np.array([point.values.std(ddof=1) for point in points]),
        np.array([len(point.values) for point in points], dtype=np.int64),
    )


def chance_band(sd: float, repeats: int) -> tuple[float, float]:
    """Return within what 95 % of the standard deviations of `repeats` values lie if the true one is `sd`.

    Of normal values: s^2 (n - 1) / sd^2 has a chi-squared distribution with n - 1 degrees of freedom.
    """
    from scipy.stats import chi2

    low, high = (float(chi2.ppf(q, repeats - 1)) for q in (0.025, 0.975))
    return sd * math.sqrt(low / (repeats - 1)), sd * math.sqrt(high / (repeats - 1))


def grows_with_size(means: FloatArray, sds: FloatArray) -> float | None:
    """Return Spearman's correlation of spread and size of the mean where it is beyond chance (p < 0.01), else None."""
    from scipy.stats import spearmanr

    if len(means) < 8 or np.ptp(np.abs(means)) == 0.0 or np.ptp(sds) == 0.0:
        return None
    found: Any = spearmanr(np.abs(means), sds)
    return float(found.statistic) if float(found.pvalue) < 0.01 else None


def draw_repeatability(view: RunView, item: Repeatability) -> bytes:
    """Return the figure of one objective as SVG."""
    means, sds, counts = spreads(view, item.objective)
    usual = Counter(counts.tolist()).most_common(1)[0][0]
    low, high = chance_band(item.sd, usual)
    unit = f" ({item.unit})" if item.unit else ""
    with new_figure(7.4, 3.1) as figure:
        axes: Any = figure.subplots(1, 1)
        axes.axhspan(low, high, color=COLOURS[0], alpha=0.10, linewidth=0)
        axes.axhline(item.sd, color=COLOURS[0], label=f"pooled sd, {item.sd:.2g} {item.unit}".rstrip())
        axes.fill_between([], [], [], color=COLOURS[0], alpha=0.18, label=f"95 % of sds of {usual} by chance")
        axes.plot(
            means, sds, "o", color=SOFT, markersize=3.4, alpha=0.65, markeredgewidth=0, label="a condition"
        )
        axes.set_ylim(0, 1.08 * max(float(sds.max()), high))
        axes.set_xlabel(f"mean of {item.objective}{unit}")
        axes.set_ylabel(f"sd of single trials{unit}")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.2)
        return as_svg(figure)
