"""From a trial's streams to its objectives."""

import math
import traceback
from collections.abc import Iterator, Mapping

from labrun.errors import LabrunError
from labrun.objectives import Asked, Objective, TrialSignals, Truncated, make_objective
from labrun.runner.motion import TrialMotion
from labrun.signals import LongSignals, Signal, Signals
from labrun.spec import Condition, Experiment


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
        return {name: one for name, one in self._objectives.items() if isinstance(one, Asked)}

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
                place = _place(objective, error)
                cause = f"{type(error).__name__}: {error} ({place})"
                raised = f"{name}: {type(error).__name__} ({place})"
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
        known = {n: one for n, one in self._objectives.items() if isinstance(one, Truncated)}
        found = {name: one.truncation(signals) for name, one in known.items()}
        return {name: bound for name, bound in found.items() if bound > 0.0}

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
    """Return file and line where a plugin raised; where it begins, if what it returned was no number."""
    code = getattr(type(objective).__call__, "__code__", None)
    frames = traceback.extract_tb(error.__traceback__)[1:]
    if code is None or not frames:
        where = (code.co_filename, code.co_firstlineno) if code is not None else ("a compiled plugin", 0)
    else:
        own = [frame for frame in frames if frame.filename == code.co_filename] or frames
        where = (own[-1].filename, own[-1].lineno or 0)
    return f"{where[0]}, line {where[1]}"


class _TaredSignals(Mapping[str, Signal]):
    """Every channel by ``device.channel``, made when asked for, whole or in pieces: a trial may exceed memory."""

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
