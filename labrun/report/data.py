"""A stored run as figures and findings need it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import PluginError, SpecError
from labrun.experiment import CYCLES, Experiment, FitTable, Value, condition_key, loads_experiment
from labrun.objectives import make_objective
from labrun.report.text import condition_text, interval_text, spaced, with_unit
from labrun.search import Best, t_interval
from labrun.store import Run, TrialOutcome, imported_channels, mean_truncation


@dataclass(frozen=True, slots=True)
class Point:
    """All accepted values of one objective at one condition."""

    condition: Mapping[str, Value]
    values: FloatArray
    trials: tuple[TrialOutcome, ...]
    at_least: bool = False
    """Whether some of the values are bounds from below: trials that went on for as long as they were allowed to."""
    truncation: float = 0.0
    """What cut cycles may have done to the mean."""

    @property
    def mean(self) -> float:
        """Mean of the values."""
        return float(self.values.mean())

    @property
    def ci95(self) -> tuple[float, float] | None:
        """95 % t-interval of the mean; None for a single value, and where some are only bounds."""
        return None if self.at_least else t_interval(self.values, self.mountings, self.truncation)

    @property
    def mountings(self) -> tuple[int | None, ...]:
        """The mounting of each value."""
        return tuple(trial.mounting for trial in self.trials)


@dataclass(frozen=True)
class RunView:
    """A run with its experiment and its confirmed best.

    Attributes
    ----------
    run
        Open for reading.
    experiment
        What it did.
    best
        Of the whole run; None without a goal.
    """

    run: Run
    experiment: Experiment
    best: Best | None

    @cached_property
    def objective(self) -> str | None:
        """The objective with a goal, or the first there is."""
        goal = self.experiment.goal
        return goal[0] if goal is not None else next(iter(self.experiment.objectives), None)

    @cached_property
    def unit(self) -> str:
        """Unit of the objective."""
        if self.best is not None:
            return self.best.unit
        return self.unit_of(self.objective) if self.objective is not None else ""

    def unit_of(self, objective: str) -> str:
        """Return the unit of an objective, from that of its channel in the first trial that has it.

        Empty where the plugin that made the numbers is not installed: they stay readable without their unit.
        """
        table = self.experiment.objectives[objective]
        try:
            return make_objective(objective, table).unit(self.channel_unit(table.channel))
        except (PluginError, SpecError):
            return ""

    @cached_property
    def channel(self) -> str | None:
        """The channel to show: the objective's, the first that is fitted, or the first that was recorded."""
        table = self.experiment.objectives.get(self.objective or "")
        if table is not None and table.channel is not None:
            return table.channel
        if self.experiment.fit is not None and self.experiment.fit.signals:
            return next(iter(self.experiment.fit.signals.values()))
        for outcome in self.run.outcomes:
            for name, signals in self.run.signals(outcome.index).items():
                if signals.columns:
                    return f"{name}.{signals.columns[0]}"
        return None

    def channel_unit(self, channel: str | None) -> str:
        """Return the SI unit of a channel, empty if it was never recorded."""
        device, _, name = (channel or "").partition(".")
        for outcome in self.run.outcomes:
            if outcome.status == "failed":
                continue
            signals = self.run.signals(outcome.index).get(device)
            if signals is not None:
                return signals.unit(name) if name in signals.columns else ""
        return ""

    @cached_property
    def trace_factor(self) -> float | None:
        """What the shown channel is multiplied by to be in the objective's unit; None to show it as recorded."""
        table = self.experiment.objectives.get(self.objective or "")
        if table is None or table.channel is None:
            return None
        scale, length_m = table.settings.get("scale", 1.0), table.settings.get("divide_by_m", 1.0)
        return None if scale == length_m == 1.0 else float(scale) / float(length_m)

    @property
    def objective_label(self) -> str:
        """Axis label of the objective."""
        return with_unit(str(self.objective), self.unit)

    @property
    def trace_label(self) -> str:
        """Axis label of traces: the objective's quantity over time, or the channel, with a minus if it is turned."""
        if self.trace_factor not in (None, -1.0):
            return self.objective_label
        channel = self.channel or ""
        sign = "" if self.trace_factor is None else "\N{MINUS SIGN}"
        return with_unit(sign + spaced(channel.partition(".")[2]), self.channel_unit(channel))

    def with_best(self, text: str, sign: str = "") -> str:
        """Return a text followed by the confirmed best with interval and location, for the subtitle of a figure."""
        if self.best is None:
            return text
        value = interval_text(self.best.value, self.best.ci95, self.best.unit)
        return f"{text}.  Best{sign}: {self.best.objective_name} {value} at {condition_text(self.best.parameters)}"

    def trace(self, outcome: TrialOutcome, channel: str) -> tuple[FloatArray, FloatArray] | None:
        """Return time and values of a channel during a trial's motion; None if it was not recorded.

        Tared, and in the objective's unit where the objective scales its channel.
        """
        device, _, name = channel.partition(".")
        signals = self.run.signals(outcome.index).get(device)
        if signals is None or name not in signals.columns:
            return None
        shown = signals.between(0.0, outcome.duration_s).tared().signal(name)
        return shown.time_s, shown.values * (self.trace_factor or 1.0)

    def points(
        self, objective: str, *, roles: Sequence[str] = ("measure", "fresh", "confirm")
    ) -> list[Point]:
        """Return every distinct condition with its accepted values, in the order of first measurement."""
        counted = (
            outcome
            for outcome in self.run.outcomes
            if outcome.status == "done" and outcome.role in roles and objective in outcome.objectives
        )
        return [
            Point(
                trials[0].condition,
                np.array([trial.objectives[objective] for trial in trials]),
                tuple(trials),
                objective == CYCLES and any(trial.censored for trial in trials),
                mean_truncation(trials, objective),
            )
            for trials in by_condition(counted).values()
        ]

    @property
    def best_trials(self) -> list[TrialOutcome]:
        """The accepted trials of the confirmed best that have a channel to show."""
        if self.best is None or self.channel is None:
            return []
        return self.accepted_trials.get(condition_key(self.best.parameters), [])

    @property
    def accepted_trials(self) -> dict[object, list[TrialOutcome]]:
        """The accepted trials of every condition, all roles but references, in the order of first measurement."""
        return by_condition(
            outcome
            for outcome in self.run.outcomes
            if outcome.status == "done" and outcome.role != "reference"
        )


def by_condition(outcomes: Iterable[TrialOutcome]) -> dict[object, list[TrialOutcome]]:
    """Return trials by the key of their condition."""
    groups: dict[object, list[TrialOutcome]] = {}
    for outcome in outcomes:
        groups.setdefault(condition_key(outcome.condition), []).append(outcome)
    return groups


def experiment_of(experiment_toml: str, name: str) -> Experiment:
    """Return the experiment of a run.

    An imported recording keeps its ``recording.toml``, which knows neither rig nor gait: it becomes a plain run
    without objectives, of which the first output is what to look at.

    Raises
    ------
    SpecError
        The stored experiment file does not hold.
    """
    channels = imported_channels(experiment_toml)
    if not channels:
        return loads_experiment(experiment_toml, name, plugins=False).experiment
    outputs = [channel for channel, table in channels.items() if table.get("kind") == "output"]
    fit = FitTable(signals={channel: f"output.{channel}" for channel in outputs})
    # Not validated: a rig, a gait and a trial table are what a recording made elsewhere does not have.
    construct: Any = Experiment.model_construct
    experiment: Experiment = construct(
        title=f"Recording {name}", kind="run", fit=fit, objectives={}, units={}
    )
    return experiment


def trial_tare_s(experiment: Experiment) -> float:
    """Return how long a tare takes, s; 0 without one."""
    trial = getattr(experiment, "trial", None)
    return trial.tare.duration_s if trial is not None and trial.tare is not None else 0.0
