"""Trials as a pandas table, samples as xarray datasets; both are imported only when asked for."""

import importlib
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from labrun.errors import RecordingError, RequestError
from labrun.store import hdf5, layout
from labrun.store.hdf5 import Column, Table
from labrun.store.table import variables
from labrun.store.trial import TrialOutcome

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

TRIAL = "trial"
SAMPLE = "sample"
TRIAL_INDEX = "trial_index"
_MEANING = {
    "time_s": "time since the start of the trial",
    "device_time_s": "the device's own time",
    "host_time_s": "time of arrival, by this machine's clock",
}


class Named(Protocol):
    """What a column is."""

    @property
    def name(self) -> str:
        """Its name."""
        ...

    @property
    def unit(self) -> str:
        """Its unit."""
        ...


class Readable(Protocol):
    """One table of a trial, wherever it is."""

    @property
    def columns(self) -> Sequence["Named"]:
        """Names and units of its columns, without their values."""
        ...

    def read(self) -> Table:
        """Return it whole."""
        ...


class Tables(Protocol):
    """Every table of one trial: devices, ``command``, ``settle``."""

    @property
    def names(self) -> Sequence[str]:
        """Names of the tables there are."""
        ...

    def __getitem__(self, name: str) -> Readable: ...


class Source(Protocol):
    """Where the tables of all trials are (`labrun.store.sources.TrialSources`); open within a ``with``."""

    def __enter__(self) -> "Source": ...

    def __exit__(self, *_: object) -> None: ...

    def tables(self, index: int) -> AbstractContextManager[Tables]:
        """Open the tables of one trial."""
        ...


def trials_frame(outcomes: Sequence[TrialOutcome], units: Mapping[str, str]) -> "pd.DataFrame":
    """Return one row a trial, by the trial's index.

    Parameters
    ----------
    outcomes
        In order of execution, whatever their status.
    units
        Of conditions and objectives by name.

    Returns
    -------
    DataFrame
        Conditions, repeat, status, objectives, role, reason, started_s, duration_s, settle_reason, settle_duration_s,
        attempt, period_s; ``attrs["units"]`` has the unit of each column that has one. NaN, or empty text, stands
        where a trial has no such value.

    Raises
    ------
    RequestError
        pandas is not installed.
    """
    pandas = _library("pandas", "a table of trials")
    index, *columns = variables(outcomes, units)
    frame: pd.DataFrame = pandas.DataFrame(
        {column.name: column.values for column in columns}, index=pandas.Index(index.values, name=TRIAL)
    )
    frame.attrs["units"] = {column.name: column.unit for column in columns if column.unit}
    return frame


def trial_dataset(name: str, index: int, source: Source, *, tared: bool) -> "xr.Dataset":
    """Return the samples of one table of one trial, over ``time_s``.

    Raises
    ------
    RecordingError
        There is no such trial, or no such table in it; names those there are.
    RequestError
        xarray is not installed.
    """
    xarray = _library("xarray", "signals")
    with source as opened, opened.tables(index) as tables:
        if name not in tables.names:
            raise _unknown(name, f"trial {index}", tables.names)
        table = tables[name].read()
    times = {column.name: column for column in table.columns if column.name in layout.TIMES}
    signals = [column for column in table.columns if column.name not in layout.TIMES]
    data = {column.name: _variable(xarray, "time_s", column, tared) for column in signals}
    coordinates = {
        key: xarray.Variable("time_s", column.values, {"units": "s", "long_name": _MEANING[key]})
        for key, column in times.items()
    }
    return xarray.Dataset(data, coordinates, {**table.attributes, "device": name, "trial": index})


def run_dataset(name: str, indices: Sequence[int], source: Source, *, tared: bool) -> "xr.Dataset":
    """Return the samples of one table in all trials, one after the other, over ``sample``.

    ``trial_index`` and ``time_s`` tell of each sample which trial it belongs to, and when it was. A channel that a
    trial does not have is NaN there.

    Raises
    ------
    RecordingError
        No trial has such a table; names those there are.
    RequestError
        xarray is not installed.
    """
    xarray = _library("xarray", "signals")
    read: list[tuple[int, Table]] = []
    others: dict[str, None] = {}
    with source as opened:
        for index in indices:
            with opened.tables(index) as tables:
                others |= dict.fromkeys(tables.names)
                if name in tables.names:
                    read.append((index, tables[name].read()))
    if not read:
        raise _unknown(name, "the run", list(others))
    counts = [len(table.columns[0].values) for _, table in read]
    columns: dict[tuple[str, str], list[tuple[int, Column]]] = {}
    for position, (_, table) in enumerate(read):
        for column in table.columns:
            columns.setdefault((column.name, column.unit), []).append((position, column))
    marks = np.repeat(np.array([index for index, _ in read], dtype=np.int64), counts)
    coordinates = {TRIAL_INDEX: xarray.Variable(SAMPLE, marks, {"long_name": "index of the trial"})}
    data: dict[str, Any] = {}
    for (channel, unit), parts in columns.items():
        values = _joined(parts, counts, tared=tared)
        if channel in layout.TIMES:
            attributes = {"units": unit, "long_name": _MEANING[channel]}
            coordinates[channel] = xarray.Variable(SAMPLE, values, attributes)
            continue
        free = channel
        while free in data or free == TRIAL_INDEX:
            free += "_"  # the same channel in another unit, after the experiment changed
        data[free] = xarray.Variable(SAMPLE, values, {"units": unit})
    return xarray.Dataset(data, coordinates, {"device": name, "tared": int(tared)})


def _variable(xarray: Any, dimension: str, column: Column, tared: bool) -> Any:
    offset = column.attributes.get(hdf5.TARE)
    attributes: dict[str, Any] = {"units": column.unit}
    if offset is not None:
        attributes |= {"tare": offset, "tared": int(tared)}
    return xarray.Variable(dimension, _values(column, tared=tared), attributes)


def _values(column: Column, *, tared: bool) -> NDArray[np.float64]:
    offset = column.attributes.get(hdf5.TARE)
    return column.values if offset is None or not tared else column.values - float(offset)


def _joined(
    parts: Sequence[tuple[int, Column]], counts: Sequence[int], *, tared: bool
) -> NDArray[np.float64]:
    ends = np.cumsum(counts)
    values = np.full(int(ends[-1]), np.nan)
    for position, column in parts:
        values[ends[position] - counts[position] : ends[position]] = _values(column, tared=tared)
    return values


def _unknown(name: str, where: str, names: Sequence[str]) -> RecordingError:
    return RecordingError(
        f"{where} has no signals {name!r}", hint=f"recorded were: {', '.join(names) or 'none'}"
    )


def _library(name: str, purpose: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise RequestError(
            f"{purpose} needs {name}, which is not installed", hint="pip install 'labrun[data]'"
        ) from error
