"""Picture of a basket fit: measured and fitted forces, residuals, and the baskets' merit."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from labrun.fit.figure import _STYLE
from labrun.fit.regression.least_squares import Regression

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]
_MEASURED, _BEST, _TAKEN = "#9aa5b1", "#1d4e89", "#c2410c"


def draw_baskets(
    time_s: FloatArray,
    measured: Mapping[str, FloatArray],
    solved: Mapping[str, Mapping[str, Regression]],
    conditions: Mapping[str, float],
    taken: str,
    best: str,
    unit: str,
) -> "Figure":
    """Draw the first trial's outputs over `time_s`, and errors of every basket; solved is output -> basket."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(cast("Any", _STYLE)):
        figure = Figure(figsize=(9.0, 8.2), dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(3, len(measured), squeeze=False, height_ratios=(2.0, 1.1, 1.8))
        count = len(time_s)
        for place, (output, values) in enumerate(measured.items()):
            top, low, merit = axes[:, place]
            top.plot(time_s, values[:count], color=_MEASURED, lw=0.8, label="measured")
            for name, colour in {best: _BEST, taken: _TAKEN}.items():
                fitted = solved[output][name].fitted[:count]
                top.plot(time_s, fitted, color=colour, lw=1.2, label=name)
                low.plot(time_s, values[:count] - fitted, color=colour, lw=0.7)
            top.set(title=f"{output}, first trial", ylabel=f"force ({unit})")
            top.legend(ncols=3, fontsize=7)
            low.set(xlabel="time (s)", ylabel=f"residual ({unit})")
            names = list(solved[output])
            at = np.arange(len(names))
            some = [solved[output][name] for name in names]
            merit.bar(at - 0.2, [one.mae for one in some], 0.38, color=_MEASURED, label="MAE")
            merit.bar(
                at + 0.2, [one.cv for one in some], 0.38, yerr=[one.cv_error for one in some],
                color=_BEST, error_kw={"lw": 0.7}, label="MAE, cross-validated",
            )  # fmt: skip
            merit.set(ylabel=f"mean absolute error ({unit})")
            merit.set_ylim(top=1.45 * max(one.cv + one.cv_error for one in some))
            labels = [f"{name}\ncond {conditions[name]:.0e}" for name in names]
            merit.set_xticks(at, labels, rotation=40, ha="right", fontsize=6.5)
            merit.legend(ncols=2, fontsize=7)
    return figure
