"""A run for other programs: CSV of its trials, or netCDF of everything."""

import csv
import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from labrun.errors import RequestError
from labrun.store import packed_file, table
from labrun.store.disk import fsync_file, saving
from labrun.store.reading import Run
from labrun.store.recording import is_recording
from labrun.store.trial import TrialOutcome

SUFFIXES = {"csv": ".csv", "netcdf": ".nc"}


def export_run(
    run: Run, to: str, output: Path | None = None, *, outcomes: Sequence[TrialOutcome] | None = None
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
        to_csv(run, target, outcomes)
    else:
        to_netcdf(run, target)
    return target


def _beside(run: Run, suffix: str) -> Path:
    if is_recording(run.path):
        return Path(f"{run.name}{suffix}")
    folder = run.path if run.path.is_dir() else run.path.parent
    return folder / f"{run.name}-{run.identifier}{suffix}"


def to_csv(run: Run, output: Path, outcomes: Sequence[TrialOutcome] | None = None) -> None:
    """Write one row a trial: index, conditions, repeat, status, objectives; then role, reason and times.

    Numbers are written so that they come back bit for bit; an empty cell is a number that there is not.

    Raises
    ------
    StoreError
        The file cannot be written.
    """
    columns = table.variables(run.outcomes if outcomes is None else outcomes, {})
    with saving(output.name, output.parent, "the run itself is untouched"):
        output.parent.mkdir(parents=True, exist_ok=True)
        with output.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([column.name for column in columns])
            for row in zip(*(column.values.tolist() for column in columns), strict=True):
                writer.writerow(
                    ["" if isinstance(cell, float) and math.isnan(cell) else cell for cell in row]
                )


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
