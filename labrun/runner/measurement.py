"""All trials of one condition: how many, in which order, and which of them count."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from labrun.devices import FloatArray
from labrun.errors import ExperimentError
from labrun.spec import Condition, Outliers, RepeatRule, condition_text
from labrun.store import Role, TrialOutcome, mean_truncation


@dataclass(frozen=True, slots=True)
class Measurement:
    """The trials of one condition, in the order they ran; rejected and failed ones are among them.

    Attributes
    ----------
    role
        "measure", "reference", "fresh" or "confirm".
    outcomes
        Every trial, whatever its status.
    """

    condition: Condition
    role: Role
    outcomes: tuple[TrialOutcome, ...]

    @property
    def accepted(self) -> tuple[TrialOutcome, ...]:
        """The trials that count."""
        return tuple(outcome for outcome in self.outcomes if outcome.status == "done")

    def of_mounting(self, number: int | None) -> "Measurement":
        """Return the trials of one mounting; all where nothing is set by hand."""
        if number is None:
            return self
        return replace(self, outcomes=tuple(o for o in self.outcomes if o.mounting == number))

    @property
    def mountings(self) -> tuple[int | None, ...]:
        """The mounting of each accepted trial."""
        return tuple(outcome.mounting for outcome in self.accepted)

    def values(self, objective: str) -> FloatArray:
        """Return an objective's value in each accepted trial, shape (accepted,)."""
        return np.array([outcome.objectives[objective] for outcome in self.accepted], dtype=float)

    def truncation(self, objective: str) -> float:
        """Return what cut cycles may have done to the mean of an objective: they do it to every repeat alike."""
        return mean_truncation(self.accepted, objective)

    def mean(self, objective: str) -> float:
        """Return the mean over the accepted trials.

        Raises
        ------
        ExperimentError
            No trial was accepted: there is no mean, and a NaN would pass unseen.
        """
        values = self.values(objective)
        if len(values) == 0:
            reasons = "; ".join(dict.fromkeys(o.reason for o in self.outcomes if o.reason)) or "none was run"
            raise ExperimentError(
                f"no accepted trial of {condition_text(self.condition)}: {reasons}",
                hint="labrun show lists the trials with their reasons",
            )
        return float(np.mean(values))

    def standard_error(self, objective: str) -> float:
        """Return the standard error of the mean; infinite with fewer than two accepted trials."""
        values = self.values(objective)
        if len(values) < 2:
            return math.inf
        return float(np.std(values, ddof=1) / math.sqrt(len(values)))


def needs_another(measurement: Measurement, rule: RepeatRule) -> bool:
    """Tell whether a condition needs another repeat.

    At least `rule.min` accepted trials, then more until every standard error named is small enough, at most
    `rule.max`. A rejected or failed trial is replaced; after `rule.max` replacements the condition is left as it is,
    so that a condition that always fails cannot hold the run for ever.
    """
    accepted = len(measurement.accepted)
    if accepted >= rule.max or len(measurement.outcomes) - accepted > rule.max:
        return False
    if accepted < rule.min:
        return True
    return any(measurement.standard_error(name) > bound for name, bound in rule.standard_error.items())


Order = Literal["shuffled", "as-listed"]
_STREAM = 0x0BDE
"""Sets the generator of orders apart from those of devices, which are derived from the same seed."""


def block_order(needed: Sequence[int], order: Order, *, seed: int, trial_index: int) -> list[int]:
    """Return the conditions of one block in the order they run.

    Parameters
    ----------
    needed
        Positions of the conditions that need another repeat.
    order
        "shuffled", so that drift of the bench falls on all conditions alike, or "as-listed".
    seed, trial_index
        The run's seed and the index of the block's first trial: the same run always gets the same order.
    """
    positions = list(needed)
    if order == "shuffled":
        rng = np.random.default_rng(np.random.SeedSequence((seed, _STREAM, trial_index)))
        positions = [positions[i] for i in rng.permutation(len(positions))]
    return positions


OUTLIER = "outlier: "
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
            f"{OUTLIER}{objective} = {outcome.objectives[objective]:.4g} is {abs(score):.1f} robust standard "
            f"deviations from the median of {len(accepted)} repeats (limit {rule.threshold:g})"
        )
        for outcome, score in zip(accepted, scores, strict=True)
        if abs(score) > rule.threshold
    }
