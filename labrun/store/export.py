"""A run for other programs: CSV of its trials, netCDF of everything, pandas and xarray, imported when asked for."""

import csv
import importlib
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RecordingError, RequestError
from labrun.signals import TIMES, Signals
from labrun.store import packed_file, trial
from labrun.store.disk import fsync_file, saving
from labrun.store.packed_file import SAMPLE, TRIAL_INDEX
from labrun.store.reading import Run
from labrun.store.recording import is_recording
from labrun.store.trial import TrialOutcome, Variable, variables
from labrun.toml import unit_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

TRIAL = "trial"
_ABOUT = ("rate_hz", "lost", "saturated", "clock_glitches")
_MEANING = {
    "time_s": "time since the start of the trial",
    "device_time_s": "the device's own time",
    "host_time_s": "time of arrival, by this machine's clock",
}


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


def trial_dataset(run: Run, name: str, index: int, *, tared: bool) -> "xr.Dataset":
    """Return the signals of one device in one trial, over ``time_s``.

    Raises
    ------
    RecordingError
        There is no such trial, or no such device in it; names those there are.
    RequestError
        xarray is not installed.
    """
    xarray = _library("xarray", "signals")
    tables = run.tables(index)
    if name not in tables:
        raise _unknown(name, f"trial {index}", list(tables))
    measured = tables[name]
    shown = measured.tared() if tared else measured
    data = {}
    for column, unit in zip(shown.columns, shown.units, strict=True):
        attributes: dict[str, Any] = {"units": unit}
        if column in measured.tare:
            attributes |= {"tare": measured.tare[column], "tared": int(tared)}
        data[column] = xarray.Variable("time_s", shown.column(column), attributes)
    coordinates = {
        key: xarray.Variable("time_s", values, {"units": "s", "long_name": _MEANING[key]})
        for key, values in _times(shown).items()
    }
    about: dict[str, Any] = {"device": name, "trial": index}
    if shown.device_time_s is not None:
        about = {key: getattr(shown, key) for key in _ABOUT} | about
    return xarray.Dataset(data, coordinates, about)


def run_dataset(run: Run, name: str, *, tared: bool) -> "xr.Dataset":
    """Return the signals of one device in all trials, one after the other, over ``sample``.

    ``trial_index`` and ``time_s`` tell of each sample which trial it belongs to, and when it was. A channel that a
    trial does not have is NaN there.

    Raises
    ------
    RecordingError
        No trial has such a device; names those there are.
    RequestError
        xarray is not installed.
    """
    xarray = _library("xarray", "signals")
    read: list[tuple[int, Signals]] = []
    others: dict[str, None] = {}
    for outcome in run.outcomes:
        tables = run.tables(outcome.index)
        others |= dict.fromkeys(tables)
        if name in tables:
            read.append((outcome.index, tables[name].tared() if tared else tables[name]))
    if not read:
        raise _unknown(name, "the run", list(others))
    counts = [len(signals) for _, signals in read]
    marks = np.repeat(np.array([index for index, _ in read], dtype=np.int64), counts)
    coordinates = {TRIAL_INDEX: xarray.Variable(SAMPLE, marks, {"long_name": "index of the trial"})}
    columns: dict[tuple[str, str], list[tuple[int, FloatArray]]] = {}
    for index, (_, signals) in enumerate(read):
        for key, values in _times(signals).items():
            columns.setdefault((key, "s"), []).append((index, values))
        for column, unit in zip(signals.columns, signals.units, strict=True):
            columns.setdefault((column, unit), []).append((index, signals.column(column)))
    data: dict[str, Any] = {}
    for (column, unit), parts in columns.items():
        values = _joined(parts, counts)
        if column in TIMES:
            coordinates[column] = xarray.Variable(
                SAMPLE, values, {"units": unit, "long_name": _MEANING[column]}
            )
            continue
        free = column
        while free in data or free == TRIAL_INDEX:
            free += "_"  # the same channel in another unit, after the experiment changed
        data[free] = xarray.Variable(SAMPLE, values, {"units": unit})
    return xarray.Dataset(data, coordinates, {"device": name, "tared": int(tared)})


def _times(signals: Signals) -> dict[str, FloatArray]:
    axes = {name: getattr(signals, name) for name in TIMES}
    return {name: values for name, values in axes.items() if values is not None}


def _joined(parts: Sequence[tuple[int, FloatArray]], counts: Sequence[int]) -> FloatArray:
    """Return the values of all trials, NaN for those that have none."""
    ends = np.cumsum(counts)
    values = np.full(int(ends[-1]), np.nan)
    for index, part in parts:
        values[ends[index] - counts[index] : ends[index]] = part
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


SUFFIXES = {"csv": ".csv", "netcdf": ".nc"}


def export_run(
    run: Run,
    to: str,
    output: Path | None = None,
    *,
    outcomes: Sequence[TrialOutcome] | None = None,
    units: Mapping[str, str] | None = None,
) -> Path:
    """Write a run in another format.

    Parameters
    ----------
    to
        ``"csv"`` or ``"netcdf"``.
    output
        The file; without it, ``<experiment>-<run>.csv`` (or ``.nc``) in the run's folder; of a recording folder,
        which is left as it is, ``<name>.csv`` in the current directory.
    outcomes
        Rows of the CSV in place of the run's own, for one that has columns more.
    units
        Of those columns, by name.

    Raises
    ------
    RequestError
        Unknown format, `output` is a folder, or a file of the recording.
    StoreError
        The file cannot be written.
    """
    if to not in SUFFIXES:
        raise RequestError(f"a run cannot be exported to {to!r}", hint=f"formats: {', '.join(SUFFIXES)}")
    target = output if output is not None else _beside(run, SUFFIXES[to])
    if target.is_dir():
        raise RequestError(
            f"--output {target} is a folder; expected the file to write",
            hint=f"--output {target / _beside(run, SUFFIXES[to]).name}",
        )
    if is_recording(run.path) and target.exists() and target.resolve().parent == run.path.resolve():
        raise RequestError(
            f"{target} is there already, in the recording that is to be exported",
            hint="name another --output",
        )
    if to == "csv":
        to_csv(run, target, outcomes, units)
    else:
        to_netcdf(run, target)
    return target


def _beside(run: Run, suffix: str) -> Path:
    if is_recording(run.path):
        return Path(f"{run.name}{suffix}")
    folder = run.path if run.path.is_dir() else run.path.parent
    return folder / f"{run.name}-{run.identifier}{suffix}"


def to_csv(
    run: Run,
    output: Path,
    outcomes: Sequence[TrialOutcome] | None = None,
    units: Mapping[str, str] | None = None,
) -> None:
    """Write one row a trial: index, conditions, repeat, status, objectives; then role, reason and times.

    A heading carries the unit in brackets, ``thrust (N)``, unless its name ends in it, ``duration_s``.

    Numbers are written so that they come back bit for bit; an empty cell is a number that there is not.

    Raises
    ------
    StoreError
        The file cannot be written.
    """
    columns = trial.variables(
        run.outcomes if outcomes is None else outcomes, {**run.units(), **(units or {})}
    )
    with saving(output.name, output.parent, "the run itself is untouched"):
        output.parent.mkdir(parents=True, exist_ok=True)
        with output.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([_heading(column) for column in columns])
            for row in zip(*(column.values.tolist() for column in columns), strict=True):
                writer.writerow(
                    ["" if isinstance(cell, float) and math.isnan(cell) else cell for cell in row]
                )


def _heading(column: Variable) -> str:
    """Return ``f (Hz)``; the name alone where it has no unit, or its ending says it."""
    if column.unit in ("", "1") or unit_of(column.name) == column.unit:
        return column.name
    return f"{column.name} ({column.unit})"


def to_netcdf(run: Run, output: Path) -> None:
    """Write the whole run as netCDF-4, in the layout of ``run.h5``.

    ``xarray.open_dataset(output)`` gives the table of trials, ``group="<device>"`` the signals of all of them.

    Raises
    ------
    StoreError
        The file cannot be written.
    """
    partial = output.with_name(f".{output.name}.partial")
    outcomes = {outcome.index: outcome for outcome in run.outcomes}
    try:
        with saving(output.name, output.parent, "the run itself is untouched"):
            output.parent.mkdir(parents=True, exist_ok=True)
            packed_file.write_packed(partial, run.texts, outcomes, run.source.tables, run.source.size())
            fsync_file(partial)
            partial.replace(output)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
