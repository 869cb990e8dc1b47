"""Figure: how long the bench took to come to rest, and whether that changed over the run."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.report.style import COLOURS, new_figure
from labrun.report.svg import as_svg
from labrun.store import TrialOutcome

FloatArray = NDArray[np.float64]

_MOST_BINS = 36
_COLOUR = {"quiet": COLOURS[0], "timeout": COLOURS[1], "time": COLOURS[2]}


def draw_settling(outcomes: Sequence[TrialOutcome]) -> bytes:
    """Return the figure as SVG: distribution of settle times by reason, and settle times in the order of trials."""
    waited = [
        (outcome.index, outcome.settle.duration_s, outcome.settle.reason)
        for outcome in outcomes
        if outcome.settle is not None
    ]
    times = np.array([duration_s for _, duration_s, _ in waited])
    reasons = sorted({reason for _, _, reason in waited})
    by_reason = [np.array([t for _, t, r in waited if r == reason]) for reason in reasons]
    colours = [_COLOUR.get(reason, COLOURS[3]) for reason in reasons]
    edges = _edges(float(times.max()))
    with new_figure(7.4, 2.7) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.25])
        left.hist(by_reason, bins=edges.tolist(), stacked=True, color=colours, label=reasons, linewidth=0)
        left.set_xlabel("settle time (s)")
        left.set_ylabel("trials")
        left.set_xlim(0, edges[-1])
        left.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.2)
        small: Any = {"markersize": 2.6, "alpha": 0.6, "markeredgewidth": 0}
        for reason, colour in zip(reasons, colours, strict=True):
            part = [(index, t) for index, t, r in waited if r == reason]
            right.plot(*zip(*part, strict=True), "o", color=colour, **small)
        right.set_xlabel("trial, in the order they ran")
        right.set_ylabel("settle time (s)")
        right.set_ylim(0, edges[-1])
        return as_svg(figure)


def _edges(longest_s: float) -> FloatArray:
    """Return edges of bins of a round width, so that times in whole steps of the clock fill them evenly."""
    least = max(longest_s, 0.1) / _MOST_BINS
    decade = 10.0 ** math.floor(math.log10(least))
    width = next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= least)
    return width * np.arange(math.floor(longest_s / width) + 2, dtype=np.float64)
