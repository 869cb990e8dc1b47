"""`labrun compare`."""

from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported
from labrun.cli.status import status


def compare(
    target: options.Target,
    other: Annotated[
        str | None,
        typer.Argument(
            help="What is held against it: another run or recording, named likewise. A model is, if not given.",
            autocompletion=options.complete_experiment,
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="The model (TOML file, plugin, package.module:object); that which the experiment or the recording "
            "names if not given.",
        ),
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE", help="Greatest relative error, such as 15%; exit code 1 if a point is beyond it."
        ),
    ] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Hold a prediction as stated, or another run, against data. Nothing is fitted.

    Prints every condition, the worst first, and the error of each channel; draws a figure.

    Example:  labrun compare hinge --model hinge-pendulum --tolerance 15%

    Example:  labrun compare hinge recordings/ring-down

    Example:  labrun compare design:swimmer rig:rowing --tolerance 10%
    """
    with reported(as_json, "interrupted; no comparison was written"):
        from labrun.app.compare import compare as compare_data

        with status() as note:
            stored = compare_data(target, other, model=model, tolerance=tolerance, results=results, note=note)
        if as_json:
            print_json(stored.to_json())
        else:
            typer.echo(stored.to_text())
    if not stored.within:
        raise typer.Exit(1)


def register(app: typer.Typer) -> None:
    """Add this module's command."""
    app.command()(compare)
