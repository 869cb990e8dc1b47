"""Data out, for other programs, and in, from elsewhere."""

from pathlib import Path

from labrun.errors import RequestError
from labrun.report import Drift, drift_of, without_drift
from labrun.store import export_run, import_recording, open_target

__all__ = ["export", "import_recording"]


def export(
    target: str | Path,
    to: str,
    output: Path | None = None,
    *,
    remove_drift: bool = False,
    results: str | Path = "results",
) -> tuple[Path, list[Drift]]:
    """Write a run as CSV, one row a trial, or as netCDF, the table and the signals.

    Parameters
    ----------
    target
        An experiment's name (its latest run), a run folder, a run.h5, or a recording folder.
    to
        ``"csv"`` or ``"netcdf"``.
    output
        The file; beside the run if None, of a recording in the current folder.
    remove_drift
        CSV: for each objective a column ``<objective>_drift_corrected`` more, less the straight line through the
        reference trials.
    results
        Where runs are.

    Returns
    -------
    Path, list of Drift
        The file, and the drift that was removed.

    Raises
    ------
    RequestError
        No such run or format, or no drift can be removed.
    """
    if remove_drift and to != "csv":
        raise RequestError(
            "--remove-drift is for the table of trials: netCDF holds what was measured",
            hint="--to csv --remove-drift",
        )
    with open_target(str(target), Path(results)) as run:
        removed = drift_of(run) if remove_drift else []
        outcomes = without_drift(run.outcomes, removed) if removed else None
        return export_run(run, to, output, outcomes=outcomes), removed
