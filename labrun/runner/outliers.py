"""The outlier rule, declared in the experiment file before any data is seen."""

import numpy as np

from labrun.devices import FloatArray
from labrun.runner.measurement import Measurement
from labrun.spec import Outliers

PREFIX = "outlier: "
"""Begins the reason of every trial this rule rejects, and of no other."""

_CONSISTENCY = 0.6745
"""Median absolute deviation of a unit normal distribution."""


def modified_z(values: FloatArray) -> FloatArray:
    """Return each value's distance from the median in robust standard deviations.

    Iglewicz and Hoaglin (1993), "How to detect and handle outliers": 0.6745 (x - median) / MAD, MAD the median
    absolute deviation. Where more than half of the values are the same, MAD is zero, and the mean absolute deviation
    takes its place (scaled by sqrt(pi/2) as in the same source).
    """
    deviation = values - np.median(values)
    mad = float(np.median(np.abs(deviation)))
    if mad > 0:
        return np.asarray(_CONSISTENCY * deviation / mad)
    mean = float(np.mean(np.abs(deviation)))
    return np.asarray(deviation / (1.253314 * mean)) if mean > 0 else np.zeros_like(values)


def find_outliers(measurement: Measurement, rule: Outliers, default_objective: str | None) -> dict[int, str]:
    """Return the accepted trials the rule rejects: trial index -> reason.

    Parameters
    ----------
    measurement
        The trials of one condition so far.
    rule
        The declared rule.
    default_objective
        The objective judged where the rule names none.
    """
    objective = rule.objective or default_objective
    accepted = measurement.accepted
    if rule.rule == "none" or objective is None or len(accepted) < rule.minimum:
        return {}
    scores = modified_z(measurement.values(objective))
    return {
        outcome.index: (
            f"{PREFIX}{objective} = {outcome.objectives[objective]:.4g} is {abs(score):.1f} robust standard deviations "
            f"from the median of {len(accepted)} repeats (limit {rule.threshold:g})"
        )
        for outcome, score in zip(accepted, scores, strict=True)
        if abs(score) > rule.threshold
    }
