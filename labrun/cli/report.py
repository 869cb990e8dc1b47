"""`labrun report`."""

from pathlib import Path
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported


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


def register(app: typer.Typer) -> None:
    """Add this module's command."""
    app.command()(report)
