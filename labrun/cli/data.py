"""`labrun show`, `export`, `import`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported


class Format(StrEnum):
    """What a run can be exported to."""

    CSV = "csv"
    NETCDF = "netcdf"


def show(
    target: options.Target, results: options.Results = options.RESULTS, as_json: options.Json = False
) -> None:
    """Show what a run found.

    Trials by status, the honest best, repeatability, drift, settling, streams.

    Example:  labrun show fin-params
    """
    with reported(as_json):
        from labrun.report.findings import findings
        from labrun.store.locate import find_run
        from labrun.store.reading import open_run

        with open_run(find_run(target, results)) as run:
            found = findings(run)
        if as_json:
            print_json(found.to_json())
        else:
            found.print()


def export(
    target: options.Target,
    to: Annotated[Format, typer.Option("--to", help="File format.")],
    output: Annotated[Path | None, typer.Option(help="File to write; beside the run if not given.")] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Write a run as CSV or netCDF.

    CSV has one row a trial; netCDF has the table and the signals.

    Example:  labrun export fin-params --to csv --output trials.csv
    """
    with reported(as_json):
        from labrun.store.export import export_run
        from labrun.store.locate import find_run
        from labrun.store.reading import open_run

        with open_run(find_run(target, results)) as run:
            written = export_run(run, to.value, output)
    if as_json:
        print_json({"output": written})
    else:
        typer.echo(f"wrote {written}")


def import_(
    directory: Annotated[Path, typer.Argument(help="Recording folder: recording.toml beside CSV files.")],
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Import a recording made elsewhere as a run.

    Example:  labrun import recordings/ring-down
    """
    with reported(as_json):
        from labrun.store.importing import import_recording

        run = import_recording(directory, results)
    if as_json:
        print_json({"run": run})
    else:
        typer.echo(f"imported as {run}")


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command()(show)
    app.command()(export)
    app.command("import")(import_)
