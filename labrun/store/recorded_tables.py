"""A recording made elsewhere, in the shape in which a run's trials are read."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from labrun.devices.samples import FloatArray
from labrun.errors import RecordingError
from labrun.store.hdf5 import Column, Table
from labrun.store.recording import RecordedTrial, Recording, SignalInfo
from labrun.store.trial import TrialOutcome


def outcomes_of(recording: Recording) -> list[TrialOutcome]:
    """Return an outcome a trial, as `labrun import` makes it: repeats count from 0, all are done."""
    return [
        TrialOutcome(
            index,
            dict(trial.condition),
            trial.repeat - 1,
            duration_s=float(trial.time_s[-1]) if len(trial.time_s) else 0.0,
        )
        for index, trial in enumerate(recording.trials)
    ]


@dataclass(frozen=True, slots=True)
class _InMemory:
    table: Table

    @property
    def columns(self) -> Sequence[Column]:
        """Its columns."""
        return self.table.columns

    def read(self) -> Table:
        """Return the table."""
        return self.table


class RecordedTables:
    """The trials of a recording, each with the tables ``input`` and ``output``.

    Implements `labrun.store.frames.Source`.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    def __enter__(self) -> "RecordedTables":
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    @contextmanager
    def tables(self, index: int) -> Iterator["_Trial"]:
        """Give the tables of one trial.

        Raises
        ------
        RecordingError
            There is no such trial.
        """
        if not 0 <= index < len(self._recording.trials):
            raise RecordingError(f"recording {self._recording.name} has no trial {index}")
        yield _Trial(_tables(self._recording, self._recording.trials[index]))


@dataclass(frozen=True, slots=True)
class _Trial:
    found: Mapping[str, Table]

    @property
    def names(self) -> Sequence[str]:
        return list(self.found)

    def __getitem__(self, name: str) -> _InMemory:
        return _InMemory(self.found[name])


def _tables(recording: Recording, trial: RecordedTrial) -> dict[str, Table]:
    sides = (("input", recording.inputs, trial.inputs), ("output", recording.outputs, trial.outputs))
    return {name: _table(name, signals, trial.time_s, values) for name, signals, values in sides if signals}


def _table(name: str, signals: Sequence[SignalInfo], time_s: FloatArray, values: FloatArray) -> Table:
    columns = [Column(signal.name, signal.unit, values[:, number]) for number, signal in enumerate(signals)]
    return Table(name, (Column("time_s", "s", time_s), *columns))
