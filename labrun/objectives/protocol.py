"""What an objective sees of a trial, what it is, and how one is made from its table in the experiment file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

import numpy as np

from labrun.devices import FloatArray, Trajectory
from labrun.errors import ExperimentError, SpecError
from labrun.spec.experiment import ObjectiveTable, Value
from labrun.spec.names import suggest


@dataclass(frozen=True, slots=True)
class Signal:
    """One channel of a trial: tared, in SI units.

    Attributes
    ----------
    time_s : (n,)
        Trial-relative time of each sample, ascending.
    values : (n,)
        Its value.
    unit
        SI unit of the values.
    """

    time_s: FloatArray
    values: FloatArray
    unit: str

    def between(self, start_s: float, end_s: float) -> "Signal":
        """Return the samples from `start_s` to `end_s`, both included."""
        first, end = np.searchsorted(self.time_s, start_s), np.searchsorted(self.time_s, end_s, side="right")
        return Signal(self.time_s[first:end], self.values[first:end], self.unit)


@dataclass(frozen=True, slots=True)
class TrialSignals:
    """Everything an objective may look at.

    Attributes
    ----------
    signals
        "device.channel" -> signal.
    command
        The motion that was asked for; its time starts at `start_s`.
    start_s, end_s
        Recording window, trial-relative.
    period_s
        Length of a gait cycle; None for a motion without cycles.
    discard_cycles
        Cycles at the start that do not count.
    condition
        Values of the trial, in the units of the file.
    """

    signals: Mapping[str, Signal]
    command: Trajectory
    start_s: float
    end_s: float
    period_s: float | None = None
    discard_cycles: int = 0
    condition: Mapping[str, Value] = field(default_factory=dict)

    def signal(self, channel: str) -> Signal:
        """Return a channel, "device.channel".

        Raises
        ------
        ExperimentError
            No such channel was recorded; lists those that were.
        """
        try:
            return self.signals[channel]
        except KeyError:
            hint = suggest(channel, self.signals, kind="recorded")
            raise ExperimentError(f'no channel "{channel}" was recorded', hint=hint) from None

    def window(self) -> tuple[float, float]:
        """Return the time that counts: the recording without the discarded cycles, cut to whole cycles.

        Raises
        ------
        ExperimentError
            The recording ends before the first cycle that counts does.
        """
        if self.period_s is None:
            return self.start_s, self.end_s
        start = self.start_s + self.discard_cycles * self.period_s
        # The tolerance keeps the last cycle when the window ends exactly with it, whatever the last bits say.
        whole = int((self.end_s - start) / self.period_s + 1e-6)
        if whole < 1:
            raise ExperimentError(
                f"the recording of {self.end_s - self.start_s:.4g} s holds no whole cycle of {self.period_s:.4g} s "
                f"after the {self.discard_cycles} that are discarded",
                hint="give the trial more cycles, or discard fewer",
            )
        return start, start + whole * self.period_s

    def counting(self, channel: str) -> Signal:
        """Return a channel's samples within `window`, with a sample made at either end of it.

        The ends are interpolated between their neighbours, so that a mean over the window covers whole cycles and not
        one sample more or less; outside the recorded samples the nearest one stands.
        """
        signal = self.signal(channel)
        start, end = self.window()
        inner = (signal.time_s > start) & (signal.time_s < end)
        if np.count_nonzero(inner) < 2:
            raise ExperimentError(f"{channel} has fewer than 2 samples between {start:.4g} and {end:.4g} s")
        if not np.isfinite(signal.values[inner]).all():
            raise ExperimentError(
                f"{channel} holds values that are not numbers between {start:.4g} and {end:.4g} s"
            )
        finite = np.isfinite(signal.values)
        ends = np.interp([start, end], signal.time_s[finite], signal.values[finite])
        time_s = np.concatenate([[start], signal.time_s[inner], [end]])
        return Signal(time_s, np.concatenate([ends[:1], signal.values[inner], ends[1:]]), signal.unit)


class Objective(Protocol):
    """A number from a trial."""

    def unit(self, channel_unit: str) -> str:
        """Return the number's unit, given that of its channel."""
        ...

    def __call__(self, signals: TrialSignals) -> float:
        """Return the number."""
        ...


class ObjectivePlugin(Protocol):
    """The class an entry point of group ``labrun.objectives`` names.

    It may also have `Settings` (a pydantic model of its own keys; the loader then reports errors in them with line and
    column), `needs_channel`, and `channel_settings` (its own keys that name channels).
    """

    def __call__(self, channel: str | None, settings: Mapping[str, Any]) -> Objective:
        """Make the objective; raises SpecError on keys that do not hold."""
        ...


def make_objective(name: str, table: ObjectiveTable) -> Objective:
    """Return an objective of an experiment file.

    Raises
    ------
    PluginError
        Unknown plugin, or one that does not import.
    SpecError
        Keys that do not hold.
    """
    from labrun import registry

    plugin = cast("ObjectivePlugin", registry.load("labrun.objectives", table.plugin))
    try:
        return plugin(table.channel, table.settings)
    except SpecError as error:
        raise SpecError(f"objective {name}: {error}") from error
    except (TypeError, ValueError) as error:  # a third party's own way of refusing its keys
        raise SpecError(f'objective {name}: "{table.plugin}" refuses its keys: {error}') from error
