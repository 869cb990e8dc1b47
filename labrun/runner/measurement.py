"""From a trial's streams to its objectives; all trials of one condition, their order, and which count."""

import math
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from labrun.devices import FloatArray
from labrun.errors import ExperimentError, LabrunError
from labrun.experiment import Condition, Experiment, Outliers, RepeatRule, condition_text
from labrun.objectives import Asked, Objective, Remarking, TrialSignals, Truncated, make_objective
from labrun.runner.motion import TrialMotion
from labrun.signals import LongSignals, Signal, Signals
from labrun.store import Role, TrialOutcome, mean_truncation


class ObjectiveError(LabrunError):
    """An objective has no finite value for a trial.

    Attributes
    ----------
    raised
        What its plugin raised, and at which line of which file; empty if it raised nothing.
    """

    def __init__(self, message: str, *, raised: str = "") -> None:
        super().__init__(message)
        self.raised = raised


class ObjectiveEvaluation:
    """Computes every objective of an experiment."""

    def __init__(self, experiment: Experiment) -> None:
        self._trial = experiment.trial
        self._tables = experiment.objectives
        self._objectives: dict[str, Objective] = {
            name: make_objective(name, table) for name, table in experiment.objectives.items()
        }

    @property
    def questions(self) -> dict[str, Asked]:
        """The objectives that a person answers."""
        return {
            name: objective for name, objective in self._objectives.items() if isinstance(objective, Asked)
        }

    def evaluate(
        self,
        measured: Mapping[str, Signals | LongSignals],
        motion: TrialMotion,
        condition: Condition,
        answers: Mapping[str, float] | None = None,
    ) -> dict[str, float]:
        """Return the value of every objective; `answers` are those that a person typed.

        Raises
        ------
        ObjectiveError
            A value is not finite, or cannot be computed; names objective, channel and cause.
        """
        signals = self._seen(measured, motion, condition)
        values: dict[str, float] = {}
        for name, objective in self._objectives.items():
            if answers is not None and name in answers:
                values[name] = answers[name]
                continue
            channel = self._tables[name].channel or "its channels"
            try:
                value = float(objective(signals))
            except LabrunError as error:
                raise ObjectiveError(f"objective {name} of {channel}: {error}") from error
            except Exception as error:  # a third party's own: it costs the trial, never what was recorded
                location = _place(objective, error)
                cause = f"{type(error).__name__}: {error} ({location})"
                raised = f"{name}: {type(error).__name__} ({location})"
                raise ObjectiveError(f"objective {name} of {channel}: {cause}", raised=raised) from error
            if not math.isfinite(value):
                raise ObjectiveError(f"objective {name} of {channel} is {value}, not a finite number")
            values[name] = value
        return values

    def truncation(
        self, measured: Mapping[str, Signals | LongSignals], motion: TrialMotion, condition: Condition
    ) -> dict[str, float]:
        """Return what cycles that the window cuts may have done to objectives, see `Truncated`; without zeros."""
        if self._trial.average is None:
            return {}
        signals = self._seen(measured, motion, condition)
        known = {
            n: objective for n, objective in self._objectives.items() if isinstance(objective, Truncated)
        }
        truncations = {name: objective.truncation(signals) for name, objective in known.items()}
        return {name: bound for name, bound in truncations.items() if bound > 0.0}

    def remarks(
        self, measured: Mapping[str, Signals | LongSignals], motion: TrialMotion, condition: Condition
    ) -> list[str]:
        """Return the remarks of objectives, see `Remarking`."""
        known = {
            n: objective for n, objective in self._objectives.items() if isinstance(objective, Remarking)
        }
        signals = self._seen(measured, motion, condition)
        remarks = {name: objective.remark(signals) for name, objective in known.items()}
        return [f"objective {name}: {text}" for name, text in remarks.items() if text]

    def _seen(
        self, measured: Mapping[str, Signals | LongSignals], motion: TrialMotion, condition: Condition
    ) -> TrialSignals:
        """Return what objectives see: every channel by ``device.channel``, tared, in trial-relative time."""
        return TrialSignals(
            signals=_TaredSignals(measured),
            command=motion.trajectory,
            start_s=0.0,
            end_s=motion.duration_s,
            period_s=motion.period_s,
            discard_cycles=self._trial.discard_cycles,
            counts_from_s=motion.counts_from_s,
            condition=condition,
            average=self._trial.average,
            frequencies_hz=motion.frequencies_hz,
        )


def _place(objective: Objective, error: Exception) -> str:
    """Return file and line where a plugin raised, or of its definition if it returned no number."""
    code = getattr(type(objective).__call__, "__code__", None)
    frames = traceback.extract_tb(error.__traceback__)[1:]
    if code is None or not frames:
        where = (code.co_filename, code.co_firstlineno) if code is not None else ("a compiled plugin", 0)
    else:
        own = [frame for frame in frames if frame.filename == code.co_filename] or frames
        where = (own[-1].filename, own[-1].lineno or 0)
    return f"{where[0]}, line {where[1]}"


class _TaredSignals(Mapping[str, Signal]):
    """Channels by ``device.channel``, computed on demand, whole or in pieces."""

    def __init__(self, measured: Mapping[str, Signals | LongSignals]) -> None:
        self._places = {
            f"{name}.{column}": (signals, column)
            for name, raw in measured.items()
            for signals in [raw.tared()]
            for column in signals.columns
        }

    def __getitem__(self, name: str) -> Signal:
        signals, column = self._places[name]
        return signals.signal(column)

    def pieces(self, name: str) -> Iterator[Signal]:
        """Yield consecutive parts of a channel; KeyError if there is none of that name."""
        signals, column = self._places[name]
        return signals.signal_pieces(column)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


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

    `default_objective`: the objective judged where the rule names none.
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
