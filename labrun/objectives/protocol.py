"""The objective protocol, the signals that it gets, and its creation from the experiment file."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray, Trajectory
from labrun.errors import ExperimentError, SpecError
from labrun.experiment import Averaging, ObjectiveTable, Value
from labrun.objectives.window import averaging_window
from labrun.signals import Signal
from labrun.toml import suggest


@runtime_checkable
class InPieces(Protocol):
    """Signals, some of them longer than memory should hold, that can also be had piece by piece."""

    def pieces(self, channel: str) -> Iterator[Signal]:
        """Yield consecutive parts of a channel; KeyError if there is none of that name."""
        ...


@dataclass(frozen=True, slots=True)
class TrialSignals:
    """Everything an objective may look at.

    Attributes
    ----------
    signals
        "device.channel" -> signal; may be `InPieces` too.
    command
        The motion that was asked for; its time starts at `start_s`.
    start_s, end_s
        Recording window, trial-relative.
    period_s
        Length of a gait cycle; None for a motion without cycles.
    discard_cycles
        Cycles at the start that do not count.
    counts_from_s
        Nothing before counts: the carriage is not at its speed yet.
    condition
        Values of the trial, in the units of the file.
    average
        What counts where joints share no cycle; None for whole gait cycles, or everything where there are none.
    frequencies_hz
        Of every joint that moves, by joint; empty where nobody asked for them.
    """

    signals: Mapping[str, Signal]
    command: Trajectory
    start_s: float
    end_s: float
    period_s: float | None = None
    discard_cycles: int = 0
    counts_from_s: float = 0.0
    condition: Mapping[str, Value] = field(default_factory=dict)
    average: Averaging | None = None
    frequencies_hz: Mapping[str, float] = field(default_factory=dict)

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
        if self.average is not None:
            return self._averaged(self.average)
        if self.period_s is None:
            return max(self.start_s, self.counts_from_s), self.end_s
        start = self.start_s + self.discard_cycles * self.period_s
        # A carriage that is not at its speed yet costs whole cycles, too.
        late = math.ceil((self.counts_from_s - start) / self.period_s - 1e-6)
        start += max(0, late) * self.period_s
        # The tolerance keeps the last cycle when the window ends exactly with it, whatever the last bits say.
        whole = int((self.end_s - start) / self.period_s + 1e-6)
        if whole < 1:
            raise ExperimentError(
                f"the recording of {self.end_s - self.start_s:.4g} s holds no whole cycle of {self.period_s:.4g} s "
                f"after the {self.discard_cycles} that are discarded",
                hint="give the trial more cycles, or discard fewer",
            )
        return start, start + whole * self.period_s

    def _averaged(self, average: Averaging) -> tuple[float, float]:
        own = None if average == "beats" else self.frequencies_hz.get(average.cycles_of)
        slowest = min(self.frequencies_hz.values(), default=None) if own is None else own
        start = max(self.start_s, self.counts_from_s)
        if slowest is not None:
            start = max(start, self.start_s + self.discard_cycles / slowest)
        window = averaging_window(start, self.end_s, tuple(self.frequencies_hz.values()), average, own)
        if window is None:
            of = "the slowest joint" if average == "beats" else average.cycles_of
            raise ExperimentError(
                f"what counts of the recording, {start:.4g} to {self.end_s:.4g} s, holds no whole cycle of {of}",
                hint="make the trial longer, or discard fewer cycles",
            )
        return window

    def counting(self, channel: str) -> Signal:
        """Return a channel's samples within `window`, with a sample made at either end of it.

        The ends are interpolated between their neighbours, so that a mean over the window covers whole cycles and not
        one sample more or less; outside the recorded samples the nearest one stands.
        """
        pieces = list(self.counting_pieces(channel))
        if len(pieces) == 1:
            return pieces[0]
        time_s = np.concatenate([pieces[0].time_s, *(piece.time_s[1:] for piece in pieces[1:])])
        values = np.concatenate([pieces[0].values, *(piece.values[1:] for piece in pieces[1:])])
        return Signal(time_s, values, pieces[0].unit)

    def pieces(self, channel: str) -> Iterator[Signal]:
        """Yield all of a channel in consecutive pieces, in one if it is short.

        Each piece begins with the last sample of the one before, so that integrals over time add up.
        """
        if isinstance(self.signals, InPieces) and channel in self.signals:
            yield from _chained(self.signals.pieces(channel))
        else:
            yield self.signal(channel)

    def counting_pieces(self, channel: str) -> Iterator[Signal]:
        """Yield what `counting` returns in pieces as `pieces` does: for trials too long for memory.

        Raises
        ------
        ExperimentError
            As `counting`; where it is found out only at the end, after the last piece.
        """
        start, end = self.window()
        before, after = _nothing(), _nothing()
        held: Signal | None = None
        count, finite = 0, True
        for number, piece in enumerate(self.pieces(channel)):
            signal = piece if number == 0 else Signal(piece.time_s[1:], piece.values[1:], piece.unit)
            inner = (signal.time_s > start) & (signal.time_s < end)
            real = np.isfinite(signal.values)
            before = _last(signal, real & (signal.time_s <= start), before)
            if inner.any():
                part = Signal(signal.time_s[inner], signal.values[inner], signal.unit)
                count += len(part.time_s)
                finite &= bool(real[inner].all())
                if held is None:
                    held = _joined(_at(start, before, part.time_s[:1], part.values[:1]), part)
                else:
                    yield held
                    held = _joined((held.time_s[-1:], held.values[-1:]), part)
            late = np.flatnonzero(real & (signal.time_s >= end))[:1]
            after = signal.time_s[late], signal.values[late]
            if len(late):
                break
        if held is None or count < 2:
            raise ExperimentError(f"{channel} has fewer than 2 samples between {start:.4g} and {end:.4g} s")
        if not finite:
            raise ExperimentError(
                f"{channel} holds values that are not numbers between {start:.4g} and {end:.4g} s"
            )
        made = _at(end, (held.time_s[-1:], held.values[-1:]), *after)
        yield Signal(
            np.concatenate([held.time_s, made[0]]), np.concatenate([held.values, made[1]]), held.unit
        )


Points = tuple[FloatArray, FloatArray]
"""Times and values of some samples."""


def _nothing() -> Points:
    return np.empty(0), np.empty(0)


def _last(signal: Signal, which: NDArray[np.bool_], otherwise: Points) -> Points:
    """Return the last of the samples that are meant, of shape (1,)."""
    last = np.flatnonzero(which)[-1:]
    return (signal.time_s[last], signal.values[last]) if len(last) else otherwise


def _at(time_s: float, before: Points, after_s: FloatArray, after: FloatArray) -> Points:
    """Return a sample between its neighbours, of which one may be missing."""
    times, values = np.concatenate([before[0], after_s]), np.concatenate([before[1], after])
    return np.array([time_s]), np.interp([time_s], times, values)


def _joined(first: Points, signal: Signal) -> Signal:
    return Signal(
        np.concatenate([first[0], signal.time_s]), np.concatenate([first[1], signal.values]), signal.unit
    )


def _chained(pieces: Iterator[Signal]) -> Iterator[Signal]:
    last: Points | None = None
    for piece in pieces:
        if len(piece.time_s) == 0:
            continue
        yield piece if last is None else _joined(last, piece)
        last = piece.time_s[-1:], piece.values[-1:]


class Objective(Protocol):
    """A number from a trial."""

    def unit(self, channel_unit: str) -> str:
        """Return the number's unit, given that of its channel."""
        ...

    def __call__(self, signals: TrialSignals) -> float:
        """Return the number."""
        ...


@runtime_checkable
class Truncated(Protocol):
    """An objective that knows what cut cycles can do to it."""

    def truncation(self, signals: TrialSignals) -> float:
        """Return a bound of what cycles that the window cuts may have added to the number, or taken from it."""
        ...


@runtime_checkable
class Remarking(Protocol):
    """An objective whose number alone may not say what happened."""

    def remark(self, signals: TrialSignals) -> str:
        """Return a remark on the number, or ""."""
        ...


class ObjectivePlugin(Protocol):
    """The class an entry point of group ``labrun.objectives`` names.

    It may also have `Settings` (a pydantic model of its own keys; the loader then reports errors in them with line and
    column), `needs_channel`, and `channel_settings` (its own keys that name channels). What it makes may be
    `Truncated`, and `Remarking`; and ``offset_free = True`` if a constant offset of its channel does not change it.
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
