"""All trials of one condition, and what they say."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labrun.devices import FloatArray
from labrun.errors import ExperimentError
from labrun.spec import condition_text
from labrun.store import Role, TrialOutcome

Condition = Mapping[str, float | str]


@dataclass(frozen=True, slots=True)
class Measurement:
    """The trials of one condition, in the order they ran; rejected and failed ones are among them.

    Attributes
    ----------
    condition
        What was measured.
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

    def values(self, objective: str) -> FloatArray:
        """Return an objective's value in each accepted trial, shape (accepted,)."""
        return np.array([outcome.objectives[objective] for outcome in self.accepted], dtype=float)

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
