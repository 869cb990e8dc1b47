"""The samples of a trial of a run in progress; its file may vanish into ``run.h5`` at any moment."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.devices.samples import FloatArray
from labrun.store import hdf5, layout
from labrun.store.folder import PACKED, TRIALS
from labrun.store.hdf5 import AnyColumn, StoredTable
from labrun.store.sources import PackedTrials, TrialTables
from labrun.store.trial import TrialOutcome

MOST_SAMPLES = 100_000
"""Of a longer trace the end is read: a night at 7 kHz is gigabytes, which nobody wants to wait for."""


@dataclass(frozen=True, slots=True)
class Trace:
    """One channel of one trial.

    Attributes
    ----------
    index
        Of the trial.
    channel
        ``device.channel``.
    time_s, values : (n,)
        From the start of the trial; tared, in `unit`.
    whole
        False if only the end of a long recording was read.
    channels
        Every channel of that trial with its unit, by ``device.channel``.
    """

    index: int
    channel: str
    unit: str
    time_s: FloatArray
    values: FloatArray
    whole: bool
    channels: dict[str, str]


def read_trace(folder: Path, index: int, wanted: Sequence[str]) -> Trace | None:
    """Read a trace without locking anything.

    Parameters
    ----------
    folder
        The run folder.
    index
        Of the trial.
    wanted
        Channels in order of preference, ``device.channel``; the first that the trial has is taken, and any channel
        where it has none of them. The trace is then of another channel than asked for.

    Returns
    -------
    Trace or None
        None if the trial is not there (any more), or has no samples.
    """
    for path in (folder / TRIALS / f"{index:06d}.h5", folder / PACKED):
        # A file may vanish, or be replaced, between any two steps; HDF5 then fails anywhere, in many ways.
        try:
            with _tables(path, index) as tables:
                return _trace(tables, index, wanted)
        except Exception:  # noqa: S112 - the next look finds the trial where it is then
            continue
    return None


def read_outcome(trials: Path, index: int) -> TrialOutcome | None:
    """Read the outcome of a trial from its file without locking it; None if it cannot be read."""
    try:
        with _unlocked(trials / f"{index:06d}.h5") as file:
            return layout.read_outcome(file)
    except Exception:  # as above
        return None


def _trace(tables: TrialTables, index: int, wanted: Sequence[str]) -> Trace | None:
    devices = {name: tables[name] for name in tables.devices}
    channels = {
        f"{name}.{column.name}": column.unit
        for name, table in devices.items()
        for column in table.columns
        if column.name not in layout.TIMES and table.count
    }
    channel = next((name for name in (*wanted, *channels) if name in channels), None)
    if channel is None:
        return None
    device, _, name = channel.partition(".")
    table = devices[device]
    values = _end(table, name)
    tare = _column(table, name).attributes.get(hdf5.TARE, 0.0)
    return Trace(
        index,
        channel,
        channels[channel],
        _end(table, "time_s"),
        values - float(tare),
        table.count <= MOST_SAMPLES,
        channels,
    )


def _end(table: StoredTable, name: str) -> FloatArray:
    column = _column(table, name)
    count = min(column.count, MOST_SAMPLES)
    return column.last(count)


def _column(table: StoredTable, name: str) -> AnyColumn:
    return next(column for column in table.columns if column.name == name)


@contextmanager
def _tables(path: Path, index: int) -> Iterator[TrialTables]:
    with _unlocked(path) as file:
        if path.name == PACKED:
            yield PackedTrials(file).tables(index)
        else:
            yield TrialTables(tuple(hdf5.member_names(file)), lambda name: hdf5.open_table(file, name))


@contextmanager
def _unlocked(path: Path) -> Iterator[Any]:
    # By its path, HDF5 would lock the file, which a network folder may refuse or hand on to the machine that runs.
    import h5py

    with path.open("rb") as stream, h5py.File(stream, "r") as file:
        yield file.id
