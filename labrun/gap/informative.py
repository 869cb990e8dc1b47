"""Outputs that carry nothing to diagnose: a sensor that shows one number throughout."""

import numpy as np

from labrun.errors import RecordingError
from labrun.fit.dataset import Dataset
from labrun.fit.problem import FEWEST_SAMPLES
from labrun.gap import criteria


def require_informative(dataset: Dataset) -> None:
    """Refuse an output that does not move beyond rounding, or by at most two steps of its resolution.

    Any model is infinitely far from it in units of its noise, and an offset would seem to explain all of that.

    Raises
    ------
    RecordingError
        With the output, the number it shows, and what to do.
    """
    for column, output in enumerate(dataset.outputs):
        values = np.concatenate([trial.outputs[:, column] for trial in dataset.trials])
        if not np.all(np.isfinite(values)):
            continue  # said elsewhere, with its place
        size, span = float(np.max(np.abs(values))), float(np.ptp(values))
        levels = np.unique(values)
        unit = "" if output.unit in ("", "1") else f" {output.unit}"
        if span <= criteria.CONSTANT_OUTPUT * size:
            shown = "zero" if size == 0.0 else f"{float(np.median(values)):.6g}{unit}"
            what = f"is {shown} throughout {dataset.name}"
        elif len(values) >= FEWEST_SAMPLES and _few_steps(levels, span):
            step = float(np.min(np.diff(levels)))
            steps = f"{round(span / step)} of its steps of {step:.3g}{unit}"
            what = f"moves by no more than {steps} throughout {dataset.name}"
        else:
            continue
        others = [one.name for place, one in enumerate(dataset.outputs) if place != column]
        rest = (
            f"take it out of the model's outputs, and diagnose with {', '.join(others)}"
            if others
            else "it is the model's only output, so that nothing is left to diagnose: record it again"
        )
        raise RecordingError(
            f"output {output.name!r} {what}: it says nothing about the model",
            hint=f"was the sensor connected, and is its range right? {rest}",
        )


def _few_steps(levels: np.ndarray[tuple[int], np.dtype[np.float64]], span: float) -> bool:
    """Tell whether different values are a few neighbouring steps of one resolution."""
    return len(levels) <= criteria.FEWEST_LEVELS + 1 and span <= (criteria.FEWEST_LEVELS + 0.01) * float(
        np.min(np.diff(levels))
    )
