"""`labrun watch`."""

import sys
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported


def watch(
    target: options.LatestTarget = None,
    channel: Annotated[
        str | None,
        typer.Option(help="Whose last trace to show, e.g. wrench.force_x; the objective's if not given."),
    ] = None,
    every_s: Annotated[float, typer.Option("--every", min=0.1, help="Time between two looks, s.")] = 1.0,
    once: Annotated[bool, typer.Option("--once", help="Look once and end.")] = False,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Watch a run that another terminal executes.

    Or another machine, in a shared folder. Reads only. Ends with the run, or with Ctrl-C.

    Example:  labrun watch fin-params
    """
    with reported(as_json):
        from rich.console import Console

        from labrun.app.watch import Watcher
        from labrun.report import render
        from labrun.report import watch as show_live
        from labrun.runner import RealClock
        from labrun.store import find_run

        clock = RealClock()
        watcher = Watcher(find_run(target, results), clock, channel)
        if as_json:
            print_json(watcher.look().to_json())
            return
        console = Console(highlight=False)
        if once or not sys.stdout.isatty():
            console.print(render(watcher.look(), console))
        else:
            show_live(watcher.look, console, clock, every_s)


def register(app: typer.Typer) -> None:
    """Add this module's command."""
    app.command()(watch)
