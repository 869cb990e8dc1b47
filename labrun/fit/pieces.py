"""Small parts of a fit's problem: sizes of outputs and priors, beginnings of trials, difference quotients."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labrun.errors import FitError
from labrun.fit.dataset import Dataset, FitTrial

if TYPE_CHECKING:
    from labrun.models import Drive, Model

FloatArray = NDArray[np.float64]

FIRST_SAMPLES = 3
"""How many samples "first" averages: few, because the output may already move."""
FEWEST_SAMPLES = 25
"""A beginning of a trial is at least this long, if the trial is."""


def output_of_state(model: "Model", state: str) -> int | None:
    """Return the column of the output of that name, which is how a model shows a state."""
    for column, output in enumerate(model.outputs):
        if output.name == state:
            return column
    return None


def channel_spread(dataset: Dataset) -> FloatArray:
    """Return the standard deviation of each output over all trials, its size where it is constant."""
    spread = []
    for column, output in enumerate(dataset.outputs):
        values = np.concatenate([trial.outputs[:, column] for trial in dataset.trials])
        size = float(np.std(values))
        if size <= 1e-12 * float(np.max(np.abs(values))):
            size = float(np.max(np.abs(values)))
        if size == 0.0:
            raise FitError(
                f"output {output.name!r} is zero throughout {dataset.name}: it says nothing about the model",
                hint="was the sensor connected? leave the output out of the model, or record it again",
            )
        spread.append(size)
    return np.array(spread)


def prior_sigma(tolerance: float | str, value: float) -> float:
    """Return the standard deviation that a tolerance stands for; relative to one for a parameter of value zero."""
    if isinstance(tolerance, str):
        return float("inf")
    return tolerance * (abs(value) if value != 0 else 1.0)


def beginning(trial: FitTrial, share: float) -> FitTrial:
    """Return the first part of a trial, not shorter than a few samples."""
    length = len(trial.time_s)
    kept = min(length, max(round(share * length), FEWEST_SAMPLES))
    return replace(
        trial, time_s=trial.time_s[:kept], inputs=trial.inputs[:kept], outputs=trial.outputs[:kept]
    )


def cut_drive(drive: "Drive", trial: FitTrial) -> "Drive":
    """Return the inputs of the first part of a trial."""
    steps = (len(trial.time_s) - 1) * drive.substeps
    last = drive.u[steps, 0] if steps < len(drive.u) else drive.u_last
    return replace(drive, time_s=trial.time_s, steps_s=drive.steps_s[:steps], u=drive.u[:steps], u_last=last)


def slope(
    residual: Callable[[float], FloatArray | None],
    centre: float,
    base: FloatArray,
    step: float,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    central: bool = True,
) -> FloatArray:
    """Return the derivative at `centre` by differences, inside bounds.

    To both sides if `central`, else to one; to the other side alone where the simulation is not finite, zero where it
    is so nowhere.
    """
    before, after = max(centre - step, low), min(centre + step, high)
    ahead = residual(after) if after > centre else None
    if ahead is not None and not central:
        return (ahead - base) / (after - centre)
    behind = residual(before) if before < centre else None
    if ahead is not None and behind is not None:
        return (ahead - behind) / (after - before)
    if ahead is not None:
        return (ahead - base) / (after - centre)
    if behind is not None:
        return (base - behind) / (centre - before)
    return np.zeros_like(base)
