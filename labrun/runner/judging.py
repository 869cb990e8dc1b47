"""From a trial's streams to its objectives."""

import math
from collections.abc import Mapping

from labrun.errors import LabrunError
from labrun.objectives import make_objective
from labrun.objectives.protocol import Objective, Signal, TrialSignals
from labrun.runner.measurement import Condition
from labrun.runner.motion import TrialMotion
from labrun.spec.experiment import Experiment
from labrun.store.trial import Stream


class ObjectiveError(LabrunError):
    """An objective has no finite value for a trial."""


class Judging:
    """Computes every objective of an experiment."""

    def __init__(self, experiment: Experiment) -> None:
        self._discard = experiment.trial.discard_cycles
        self._tables = experiment.objectives
        self._objectives: dict[str, Objective] = {
            name: make_objective(name, table) for name, table in experiment.objectives.items()
        }

    def judge(
        self,
        streams: Mapping[str, Stream],
        tare: Mapping[str, float],
        motion: TrialMotion,
        condition: Condition,
    ) -> dict[str, float]:
        """Return the value of every objective.

        Raises
        ------
        ObjectiveError
            A value is not finite, or cannot be computed; names objective, channel and cause.
        """
        signals = trial_signals(streams, tare, motion, condition, self._discard)
        values: dict[str, float] = {}
        for name, objective in self._objectives.items():
            channel = self._tables[name].channel or "its channels"
            try:
                value = float(objective(signals))
            except LabrunError as error:
                raise ObjectiveError(f"objective {name} of {channel}: {error}") from error
            except Exception as error:  # a third party's own: it costs the trial, never what was recorded
                cause = f"{type(error).__name__}: {error}"
                raise ObjectiveError(f"objective {name} of {channel}: {cause}") from error
            if not math.isfinite(value):
                raise ObjectiveError(f"objective {name} of {channel} is {value}, not a finite number")
            values[name] = value
        return values


def trial_signals(
    streams: Mapping[str, Stream],
    tare: Mapping[str, float],
    motion: TrialMotion,
    condition: Condition,
    discard: int,
) -> TrialSignals:
    """Return what objectives see: every channel by ``device.channel``, tared, in trial-relative time."""
    signals: dict[str, Signal] = {}
    for device, stream in streams.items():
        for column, channel in enumerate(stream.channels):
            name = f"{device}.{channel.name}"
            signals[name] = Signal(
                stream.time_s, stream.values[:, column] - tare.get(name, 0.0), channel.unit
            )
    return TrialSignals(
        signals=signals,
        command=motion.trajectory,
        start_s=0.0,
        end_s=motion.duration_s,
        period_s=motion.period_s,
        discard_cycles=discard,
        condition=condition,
    )
