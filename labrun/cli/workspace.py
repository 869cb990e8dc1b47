"""`labrun init`, `labrun list`."""

from pathlib import Path
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported


def init(
    directory: Annotated[Path, typer.Argument(help="Where; made if absent.", file_okay=False)] = Path(),
    as_json: options.Json = False,
) -> None:
    """Make a workspace with the shipped experiments.

    Example:  labrun init my-bench
    """
    with reported(as_json):
        from labrun.spec import create_workspace

        written, left = create_workspace(directory)
    if as_json:
        print_json({"workspace": directory.resolve(), "written": written, "left": left})
        return
    for path in written:
        typer.echo(f"wrote  {path}")
    for path in left:
        typer.echo(f"left   {path} as it was")
    there = directory.resolve() == Path.cwd().resolve()
    typer.echo("next:  labrun list" if there else f"next:  cd {directory} && labrun list")


def list_(results: options.Results = options.RESULTS, as_json: options.Json = False) -> None:
    """List the experiments of this workspace and the shipped ones.

    Example:  labrun list
    """
    with reported(as_json):
        from labrun.spec import summarise_workspace

        summaries = summarise_workspace(Path.cwd(), results)
    if as_json:
        print_json({"experiments": [summary.to_json() for summary in summaries]})
        return
    width = max((len(summary.name) for summary in summaries), default=0)
    for summary in summaries:
        runs = f"{summary.runs} run{'s' if summary.runs != 1 else ''}" if summary.runs else ""
        typer.echo(f"{summary.name:<{width}}  {summary.kind:<6} {runs:>8}  {summary.title}")


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command()(init)
    app.command("list")(list_)
