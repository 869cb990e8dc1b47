"""`labrun report`, `show`, `export`, `import`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, print_result, reported


class Format(StrEnum):
    """What a run can be exported to."""

    CSV = "csv"
    NETCDF = "netcdf"


def show(
    target: options.LatestTarget = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Show what a run found.

    Trials by status, the honest best, every condition, repeatability, drift, settling, streams, fits. Of a recording:
    channels and trials.

    Example:  labrun show fin-params
    """
    with reported(as_json):
        from labrun.app.report import opened
        from labrun.report import print_findings

        with opened(target, results=results) as findings:
            if as_json:
                print_json(findings.to_json())
            else:
                print_findings(findings)


def export(
    target: options.Target,
    to: Annotated[Format, typer.Option("--to", help="File format.")],
    output: Annotated[
        Path | None,
        typer.Option(
            help="File to write; beside the run if not given, of a recording folder in the current directory."
        ),
    ] = None,
    remove_drift: Annotated[
        bool,
        typer.Option(
            "--remove-drift",
            help="CSV: for each objective a column <objective>_drift_corrected more, less the straight line through "
            "the reference trials; at least three are needed.",
        ),
    ] = False,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Write a run as CSV or netCDF.

    CSV has one row a trial; netCDF has the table and the signals.

    Example:  labrun export fin-params --to csv --output trials.csv
    """
    with reported(as_json):
        from labrun.app.report import export as write

        written, removed = write(target, to.value, output, remove_drift=remove_drift, results=results)
    if as_json:
        print_json({"output": written, **({"drift_removed": removed} if removed else {})})
        return
    for item in removed:
        from labrun.report import interval_text

        slope = interval_text(item.slope_per_h, item.ci95, f"{item.unit}/h")
        doubt = "" if item.visible else ", which is not distinguishable from zero"
        typer.echo(f"{item.objective}: removed {slope} by {item.trials} reference trials{doubt}")
    typer.echo(f"wrote {written}")


@options.with_log_options
def import_(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...",
            help="Recording folder (recording.toml beside CSV files), to become a run; or logs of a robot, to become "
            "one: .mcap, .bag, .db3, .ulg, .csv, .npz, .h5, .mat, .pt, .parquet, a rosbag2 or LeRobot folder.",
        ),
    ],
    model: options.RobotModel = None,
    to: Annotated[
        Path | None, typer.Option(help="Of a log: the recording to write; recordings/<log> if not given.")
    ] = None,
    more: Annotated[
        list[Path] | None, typer.Option("--log", help="A further log of the same robot; repeatable.")
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", help="Of a log: show what would be read, and what is in doubt; write nothing."
        ),
    ] = False,
    log_answers: options.LogAnswersGiven = options.log_answers,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Import a recording made elsewhere as a run, or a robot's log as a recording.

    A recording written by hand needs neither: fit, gap diagnose, check and show take its folder as it is.

    Columns of a log are matched with the model by name; what is unclear is listed with a proposal and its flag.

    Example:  labrun import recordings/ring-down

    Example:  labrun import run.mcap --model arm.xml --dry-run

    Example:  labrun import monday.mcap tuesday.mcap --model arm.xml --to recordings/arm
    """
    paths = [*sources, *(more or ())]
    if model is not None:
        with reported(as_json):
            from labrun.app.logs import import_log, preview_log

            answers = log_answers()
            made = (
                preview_log(paths, model, answers=answers)
                if dry_run
                else import_log(paths, model, to, answers=answers)
            )
        print_result(made, as_json)
        return
    with reported(as_json):
        from labrun.errors import RequestError
        from labrun.store import import_recording

        if dry_run or len(paths) > 1:
            raise RequestError(
                "--dry-run and several sources are for logs of a robot, which need its model",
                hint="--model arm.xml",
            )
        run = import_recording(paths[0], results)
    if as_json:
        print_json({"run": run})
    else:
        typer.echo(f"imported as {run}")


def report(
    target: options.LatestTarget = None,
    output: Annotated[
        Path | None, typer.Option(help="File to write; report.html in the run's folder if not given.")
    ] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Write a run as one HTML file that opens offline.

    Verdict, figure, best conditions, repeatability, drift, settling, timing, rejected trials, fits, provenance.

    Example:  labrun report fin-params
    """
    with reported(as_json):
        from labrun.app.report import report as write

        written = write(target, output, results=results)
    if as_json:
        print_json({"report": written})
    else:
        typer.echo(f"wrote {written}")


COMMANDS = {"report": report, "show": show, "export": export, "import": import_}
