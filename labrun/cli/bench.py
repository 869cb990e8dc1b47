"""`labrun plugins`, `labrun doctor`."""

from pathlib import Path
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported


def plugins(as_json: options.Json = False) -> None:
    """List all plugins with their origin and state.

    Example:  labrun plugins
    """
    with reported(as_json):
        from labrun.registry import inspect_all

        found = inspect_all()
    if as_json:
        print_json({"plugins": [entry.to_json() for entry in found]})
        return
    width = max((len(entry.name) for entry in found), default=0)
    group = ""
    for entry in found:
        if entry.group != group:
            group = entry.group
            typer.echo(f"\n{group}" if group != found[0].group else group)
        state = f"  BROKEN: {entry.cause}" if entry.cause else ""
        typer.echo(f"  {entry.name:<{width}}  {entry.origin}  {entry.target}{state}")


def doctor(
    experiment: Annotated[
        str | None,
        typer.Argument(
            help="With --hardware: look at the devices of this experiment.",
            autocompletion=options.complete_experiment,
        ),
    ] = None,
    hardware: Annotated[
        bool,
        typer.Option("--hardware", help="Ask the devices themselves what and how they are; nothing moves."),
    ] = False,
    emulate: options.Emulate = False,
    overrides: options.Overrides = None,
    as_json: options.Json = False,
) -> None:
    """Check machine and ports: latency, permissions, clock.

    Example:  labrun doctor --hardware fin-params
    """
    with reported(as_json):
        from labrun.app.doctor import doctor as examine
        from labrun.report import remark_text

        remarks = examine(experiment, Path.cwd(), overrides or (), hardware=hardware, emulate=emulate)
        found = []
        for remark in remarks:
            found.append(remark)
            if not as_json:
                typer.echo(remark_text(remark))
    if as_json:
        print_json({"findings": [remark.to_json() for remark in found]})
    if any(remark.verdict == "problem" for remark in found):
        raise typer.Exit(1)


COMMANDS = {"plugins": plugins, "doctor": doctor}
