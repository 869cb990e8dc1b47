"""`labrun rank`."""

from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported


def rank(
    laboratories: Annotated[
        list[str],
        typer.Argument(
            help="Runs in which the gaits were measured: an experiment's name (its latest run) or a run folder.",
            autocompletion=options.complete_experiment,
        ),
    ],
    field: Annotated[
        str,
        typer.Option(
            help="The run in the field, named likewise.", autocompletion=options.complete_experiment
        ),
    ],
    objective: Annotated[
        str | None, typer.Option(help="Of the field; the one with a goal, or the first, if not given.")
    ] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Hold the order of gaits in the laboratory against that in the field, and name the gait to take.

    Prints every gait in each water, the rank correlation with its interval and p, and why that gait.

    Example:  labrun rank turn-torque turn-torque-current --field field-turn
    """
    with reported(as_json, "interrupted; no ranking was written"):
        from labrun.app.rank import rank as rank_gaits
        from labrun.report import ranking_text

        found = rank_gaits(laboratories, field, objective=objective, results=results)
        if as_json:
            print_json(found.to_json())
        else:
            typer.echo(ranking_text(found))


def register(app: typer.Typer) -> None:
    """Add this module's command."""
    app.command()(rank)
