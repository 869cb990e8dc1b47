"""Report a run in the terminal or as HTML, and export its data."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from labrun.app.kept import FOLDER as GAP_FOLDER
from labrun.app.kept import PAGE, read_stored
from labrun.errors import RequestError, StoreError
from labrun.report import (
    DRIFT_SUFFIX,
    Drift,
    Findings,
    RunView,
    StoredFit,
    StoredGap,
    candidate_points,
    drift_of,
    experiment_of,
    without_drift,
)
from labrun.search import Best, combined_text, read_generations, stored_result
from labrun.store import SPEC, Run, export_run, find_run, is_recording, open_target, replace_durably

REPORT = "report.html"


def report(
    target: str | Path | None = None, output: Path | None = None, *, results: str | Path = "results"
) -> Path:
    """Write a run as one HTML file that opens offline; see `write_report`.

    Parameters
    ----------
    target
        An experiment's name (its latest run), a run folder, a run.h5, or a recording; the latest run if None.
    output
        The file. Else ``report.html`` in the run's folder; of a ``run.h5`` that stands alone, ``<name>-report.html``
        beside it; of a recording, which is never written to, ``<name>-report.html`` in the current folder.
    results
        Where runs are.
    """
    with opened(target, results=results) as findings:
        return write_report(findings, output)


@contextmanager
def opened(target: str | Path | None = None, *, results: str | Path = "results") -> Iterator[Findings]:
    """Open the results of a run, or a recording; `target` and `results` as for `report`."""
    named = find_run(None, Path(results)) if target is None else target
    with open_target(str(named), Path(results)) as run:
        yield read_findings(run)


def write_report(findings: Findings, output: Path | None = None) -> Path:
    """Write the report of a run as one self-contained HTML file.

    Raises
    ------
    StoreError
        The file cannot be written.
    SpecError
        The stored experiment file does not hold.
    """
    path = output if output is not None else _beside(findings)
    from labrun.report import report_page  # matplotlib

    with _writing(path):  # before anything is computed
        path.parent.mkdir(parents=True, exist_ok=True)
    text = report_page(findings)
    with _writing(path):
        replace_durably(path, text.encode())
    return path


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"{path} cannot be written: {error.strerror}", hint="--output FILE writes elsewhere"
        ) from error


def read_findings(run: Run) -> Findings:
    """Read an open run with its fits and diagnoses, whether finished, packed, measured or imported.

    Raises
    ------
    SpecError
        The stored experiment file does not hold.
    """
    folder = run.path if run.path.is_dir() else run.path.parent
    experiment = experiment_of(run.experiment_toml, run.name)
    alone = not (folder / SPEC).is_file()
    result = None if alone else stored_result(folder)
    ended = any(event["event"] == "finished" for event in run.events)
    findings = Findings(
        run=run,
        experiment=experiment,
        best=result.best if result is not None else confirmed_best(RunView(run, experiment, None)),
        # A run is packed when it ends, so a packed file that stands alone, without the journal's last lines, is whole.
        finished=result is not None or ended or run.path.is_file(),
    )
    if alone:
        return findings
    return replace(
        findings,
        folder=folder,
        result=result,
        fits=stored_fits(folder),
        diagnosis=stored_gap(folder),
        generations=read_generations(folder / "search"),
    )


def stored_fits(folder: Path) -> list[StoredFit]:
    """Return every fit in a run's folder, by name."""
    fits = []
    for path in sorted((folder / "fit").glob("*.json")):
        try:
            numbers = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            fits.append(StoredFit(path, {}, str(error)))
            continue
        if isinstance(numbers, dict) and isinstance(numbers.get("parameters"), dict):
            picture = path.with_suffix(".png")
            fits.append(StoredFit(path, numbers, picture=picture.read_bytes() if picture.is_file() else None))
    return fits


def stored_gap(folder: Path) -> StoredGap | None:
    """Return the newest diagnosis in a run's folder, or None."""
    if not (folder / GAP_FOLDER).is_dir():
        return None
    page = f"{GAP_FOLDER}/{PAGE}" if (folder / GAP_FOLDER / PAGE).is_file() else None
    try:
        return StoredGap(read_stored(folder), page)
    except RequestError as error:
        return StoredGap({}, fault=str(error))


def confirmed_best(view: RunView) -> Best | None:
    """Return the confirmed best from the confirming trials; None without them.

    What a finished run keeps in its result, for a packed file alone and for a run that stopped close to its end.
    """
    goal = view.experiment.goal
    if goal is None:
        return None
    if view.experiment.over:
        confirmed, every = candidate_points(view, roles=("confirm",)), candidate_points(view)
    else:
        confirmed, every = view.points(goal[0], roles=("confirm",)), view.points(goal[0])
    if not confirmed:
        return None
    winner = confirmed[0]
    everything = np.concatenate([point.values for point in every])
    return Best(
        parameters=winner.condition,
        objective_name=goal[0],
        value=winner.mean,
        ci95=winner.ci95,
        unit=view.unit_of(goal[0]),
        luckiest=float(everything.max() if goal[1] == "maximise" else everything.min()),
        trials=len(winner.values),
        combined=combined_text(view.experiment),
    )


def _beside(findings: Findings) -> Path:
    if is_recording(findings.run.path):
        return Path(f"{findings.run.name}-{REPORT}")
    if findings.folder is not None:
        return findings.folder / REPORT
    return findings.run.path.with_name(f"{findings.run.path.stem}-{REPORT}")


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
        An experiment's name (its latest run), a run folder, a run.h5, or a recording's name or folder.
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
        units = {f"{item.objective}{DRIFT_SUFFIX}": item.unit for item in removed}
        return export_run(run, to, output, outcomes=outcomes, units=units), removed
