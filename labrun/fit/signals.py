"""Signals for a fit, from runs and recordings, on one even time base."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, model_validator

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.experiment import Experiment, condition_text, loads_experiment
from labrun.fit.dataset import DataCheck, Dataset, FitTrial, unchecked
from labrun.signals import Signals
from labrun.store import COMMAND, TrialOutcome, imported_channels, is_recording, open_run
from labrun.toml import resolve, suggest

GAIT = "gait"
"""The pseudo device of a gait's named quantities over time."""
_EVEN = 1e-6
Channel = tuple[FloatArray, str]
"""Values at the trial's times, and their unit."""
Take = Literal["value", "magnitude", "direction"]
UNITS = {"N m": "N"}
"""What a unit becomes when it is divided by a length, m."""


class SignalTable(BaseModel):
    """A signal of a fit; a text alone is its channel.

    Attributes
    ----------
    channel
        ``"device.channel"`` as recorded; ``"command.joint"``; ``"gait.a"``, a named part of the gait's formulas or of
        the condition, over time; of a recording, the name of a channel.
    side_channel
        The second axis of a force, for `take`.
    take
        ``"value"`` of the channel; ``"magnitude"`` or ``"direction"`` (deg, 0 along `channel`, +90 along
        `side_channel`) of the vector of both, each averaged first.
    scale, side_scale
        Each channel is multiplied by its own.
    divide_by_m
        Both are divided by this length, m: a torque at the end of a bar becomes the force that made it.
    average
        ``"cycle"``: mean over the gait cycle that has just passed, as a controller sees it; it delays by half a cycle.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    channel: str
    side_channel: str | None = None
    take: Take = "value"
    scale: Annotated[float, Field()] = 1.0
    side_scale: float = 1.0
    divide_by_m: PositiveFloat | None = None
    average: Literal["none", "cycle"] = "none"

    @model_validator(mode="before")
    @classmethod
    def _text_or_table(cls, data: Any) -> Any:
        return {"channel": data} if isinstance(data, str) else data

    @model_validator(mode="after")
    def _two_channels_for_a_vector(self) -> "SignalTable":
        if self.take != "value" and self.side_channel is None:
            raise ValueError(f'take = "{self.take}" needs a side_channel')
        if self.take == "value" and self.side_channel is not None:
            raise ValueError('a side_channel needs take = "magnitude" or "direction"')
        return self

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels it is made of."""
        return (self.channel,) if self.side_channel is None else (self.channel, self.side_channel)

    def unit(self, channel_unit: str) -> str:
        """Return the signal's unit, given its channel's."""
        if self.take == "direction":
            return "deg"
        if self.divide_by_m is None:
            return channel_unit
        return UNITS.get(channel_unit, f"{channel_unit}/m")


@dataclass(frozen=True, slots=True)
class SignalTrial:
    """One trial's signals.

    Attributes
    ----------
    label
        Names it in figures and messages.
    time_s : (n,)
        From the start of the trial, evenly spaced.
    values : name -> (n,)
    period_s
        Of a gait cycle; None if the gait has none.
    mounting
        Where something was set by hand, the number of its mounting.
    """

    label: str
    condition: Mapping[str, float | str]
    repeat: int
    time_s: FloatArray
    values: Mapping[str, FloatArray]
    period_s: float | None = None
    mounting: int | None = None

    @property
    def step_s(self) -> float:
        """Time between two samples."""
        return float(self.time_s[1] - self.time_s[0])


@dataclass(frozen=True, slots=True)
class SignalSet:
    """The same signals of every accepted trial, with their units.

    Attributes
    ----------
    left_out
        Trials that were rejected or failed; those that `where` excludes do not count.
    """

    name: str
    kind: Literal["recording", "run"]
    trials: tuple[SignalTrial, ...]
    units: Mapping[str, str]
    left_out: int = 0


def joined(inputs: Mapping[str, SignalTable], outputs: Mapping[str, SignalTable]) -> dict[str, SignalTable]:
    """Return inputs and outputs together; RequestError where a name is both."""
    both = inputs.keys() & outputs.keys()
    if both:
        raise RequestError(
            f"{', '.join(sorted(both))}: an input and an output of that name", hint="rename one"
        )
    return {**inputs, **outputs}


def load_signals(
    target: Path,
    wanted: Mapping[str, SignalTable],
    *,
    where: Mapping[str, float | str] | None = None,
    rate_hz: float | None = None,
    check: DataCheck = unchecked,
) -> SignalSet:
    """Load signals, by the name the fit gives them, of a recording folder, a run folder or a run.h5.

    Parameters
    ----------
    where
        Only trials whose condition has these values.
    rate_hz
        Of the time base; None takes that of the first measured channel.
    check
        Leaves out trials by the times at which they were sampled.

    Raises
    ------
    RequestError
        A channel that was not recorded, or a name the gait does not have; with the nearest.
    FitError
        No trial is left, or one is too short.
    """
    run, recorded, only = open_run(target), is_recording(target), dict(where or {})
    experiment = None
    if not imported_channels(run.experiment_toml):
        experiment = loads_experiment(run.experiment_toml, run.name, plugins=False).experiment
    here = [
        outcome for outcome in run.outcomes if all(outcome.condition.get(name) == only[name] for name in only)
    ]
    accepted = [outcome for outcome in here if outcome.status == "done"]
    trials: list[SignalTrial] = []
    units: dict[str, str] = {}
    kind: Literal["recording", "run"] = "recording" if recorded else "run"
    sampled: list[FitTrial] = []
    for outcome in accepted:
        channels = _Channels(outcome, run.measured(outcome.index), experiment, target, recorded)
        trial, units = channels.trial(wanted, rate_hz)
        trials.append(trial)
        sampled.append(channels.sampled(wanted))
    if not trials:
        why = "no accepted trial" if here else "no trial"
        condition = f" with {condition_text(only)}" if only else ""
        raise FitError(
            f"nothing to fit in {target}: it has {why}{condition}",
            hint=f"labrun show {target} lists its trials",
        )
    kept = {trial.label for trial in check(Dataset(run.name, target, kind, (), (), tuple(sampled))).trials}
    trials = [trial for trial in trials if trial.label in kept]
    return SignalSet(run.name, kind, tuple(trials), units, len(here) - len(trials))


def trailing_mean(values: FloatArray, samples: int) -> FloatArray:
    """Return the mean of each value and the `samples` - 1 before it; of what there is at the beginning."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    last = np.arange(1, len(values) + 1)
    first = np.maximum(last - samples, 0)
    return np.asarray((total[last] - total[first]) / (last - first))


@dataclass(frozen=True, slots=True)
class _Channels:
    """The channels of one trial on an even time base.

    `bare`: whether channels are named without their device, as in a recording, and count from its first sample to its
    last.
    """

    outcome: TrialOutcome
    measured: Mapping[str, Signals]
    experiment: Experiment | None
    target: Path
    bare: bool

    @property
    def label(self) -> str:
        return f"trial {self.outcome.index}: {condition_text(self.outcome.condition)}".rstrip(": ")

    def trial(
        self, wanted: Mapping[str, SignalTable], rate_hz: float | None
    ) -> tuple[SignalTrial, dict[str, str]]:
        """Return the trial with the wanted signals, and their units."""
        outcome, time_s = self.outcome, self._time_base(wanted, rate_hz)
        values, units = {}, {}
        for name, table in wanted.items():
            values[name], unit = self._signal(table, time_s)
            units[name] = table.unit(unit)
        repeat = outcome.repeat + 1 if self.bare else outcome.repeat  # recordings count from 1
        named = (self.label, outcome.condition, repeat)
        return SignalTrial(*named, time_s, values, outcome.period_s, outcome.mounting), units

    def sampled(self, wanted: Mapping[str, SignalTable]) -> FitTrial:
        """Return the times at which the trial was sampled, without its values, for a check of its clock."""
        time_s, none = self._base(wanted).time_s, np.empty((0, 0))
        return FitTrial(self.label, self.outcome.condition, self.outcome.repeat, time_s, none, none)

    def _base(self, wanted: Mapping[str, SignalTable]) -> Signals:
        """Return what the first wanted device measured that did; of a recording, its first channels with samples."""
        devices = [table.channel.partition(".")[0] for table in wanted.values()]
        measured = [
            self.measured[device] for device in devices if device in self.measured and device != COMMAND
        ]
        return (
            measured or [measured for measured in self.measured.values() if len(measured) or not self.bare]
        )[0]

    def _time_base(self, wanted: Mapping[str, SignalTable], rate_hz: float | None) -> FloatArray:
        """Return times at the given rate, or that of the first wanted device that was measured."""
        base = self._base(wanted)
        start_s = float(base.time_s[0]) if self.bare else 0.0
        end_s = self.outcome.duration_s if self.outcome.duration_s > 0 else float(base.time_s[-1])
        rate_hz = rate_hz or base.rate_hz
        count = int((end_s - start_s) * rate_hz * (1 + _EVEN)) + 1
        if count < 2:
            lasting = f"{end_s - start_s:.3g} s at {rate_hz:.3g} Hz"
            raise FitError(f"{self.label} is too short to be fitted: {lasting}")
        return start_s + np.arange(count) / rate_hz

    def _signal(self, table: SignalTable, time_s: FloatArray) -> Channel:
        parts, unit = [], ""
        for name, scale in zip(table.channels, (table.scale, table.side_scale), strict=False):
            values, named = self._at(name, time_s)
            unit = unit or named
            values = values * scale / (table.divide_by_m or 1.0)
            if table.average == "cycle":
                period_s = self.outcome.period_s
                if period_s is None:
                    raise RequestError(
                        f"{name} cannot be averaged over a cycle: the gait of {self.label} has none",
                        hint='give the gait a frequency_hz, or use average = "none"',
                    )
                values = trailing_mean(values, max(1, round(period_s / float(time_s[1] - time_s[0]))))
            parts.append(values)
        if table.take == "magnitude":
            return np.hypot(*parts), unit
        if table.take == "direction":
            return np.degrees(np.arctan2(parts[1], parts[0])), unit
        return parts[0], unit

    def _at(self, name: str, time_s: FloatArray) -> Channel:
        """Return a channel at these times, with its unit."""
        device, _, part = name.partition(".")
        if device == GAIT and self.experiment is not None:
            gait = resolve(self.experiment.gait.let, {**self.outcome.condition, "t": time_s})
            value = gait.get(part)
            if value is None or isinstance(value, str) or part == "t":
                hint = suggest(f"gait.{part}", [f"gait.{key}" for key in gait if key != "t"], kind="parts")
                raise RequestError(f"the gait and its conditions have no number named {part!r}", hint=hint)
            along = np.broadcast_to(np.asarray(value, dtype=float), time_s.shape).copy()
            return along, self.experiment.units.get(part, "1")
        known = {
            column if self.bare else f"{own}.{column}": (own, column)
            for own, signals in self.measured.items()
            for column in signals.columns
        }
        if name not in known:
            hint = suggest(name, known, kind="recorded channels")
            raise RequestError(f"no channel {name!r} in {self.target}", hint=hint)
        own, column = known[name]
        signal = self.measured[own].signal(column).known()
        if len(signal.time_s) < 2:
            raise FitError(
                f"{name} has fewer than 2 samples in {self.label}",
                hint="mark the trial rejected, or measure again",
            )
        return signal.at(time_s), signal.unit
