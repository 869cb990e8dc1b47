"""`labrun check`, `run`, `sweep`, `track`, `cmaes`, `design`, `resume`, `watch`."""

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, print_result, reported, to_terminal

if TYPE_CHECKING:
    from labrun.runner import Progress


def check(
    name: Annotated[
        str,
        typer.Argument(
            help="Experiment: its name, or the path of its TOML file; or the folder of a recording.",
            autocompletion=options.complete_experiment,
        ),
    ],
    dry_run: options.DryRun = False,
    overrides: options.Overrides = None,
    model: Annotated[
        str | None,
        typer.Option(help="Of a recording: the model to hold it against; its own model.toml if not given."),
    ] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Validate the whole plan: trials, time, disk, limits. Nothing moves.

    Of a recording: every fault of its files, what it holds, and whether its model takes it.

    Example:  labrun check fin-params --set trial.repeats=5

    Example:  labrun check recordings/ring-down
    """
    with reported(as_json):
        from labrun.app.check import check as check_plan
        from labrun.app.check import is_meant_as_recording, require_room

        if model is not None or is_meant_as_recording(name):
            from labrun.app.check_recording import check_recording

            print_result(check_recording(name, model=model), as_json)
            return
        plan = check_plan(name, overrides=overrides or (), dry_run=dry_run)
        if as_json:
            if not plan.excess:
                require_room(plan, results)
            print_json(plan.report())
            raise typer.Exit(2 if plan.excess else 0)
        from labrun.report import plan_text

        typer.echo(plan_text(plan, results))
        plan.require_feasible()
        require_room(plan, results)


def _command(kind: str | None, text: str) -> Callable[..., None]:
    """Return the command that runs experiments of a kind (None: of any)."""

    def command(
        name: options.Name,
        dry_run: options.DryRun = False,
        emulate: options.Emulate = False,
        overrides: options.Overrides = None,
        seed: options.Seed = None,
        limit: options.Limit = None,
        results: options.Results = options.RESULTS,
        as_json: options.Json = False,
        hide: options.Hide = None,
        hide_seed: options.HideSeed = None,
    ) -> None:
        with reported(as_json):
            from labrun.app.run import run

            result = run(
                name,
                dry_run=dry_run,
                emulate=emulate,
                overrides=overrides or (),
                kind=kind,
                seed=seed,
                limit=limit,
                hide=hide or (),
                hide_seed=hide_seed,
                results=results,
                progress=progress_display(),
            )
            print_result(result, as_json)

    command.__doc__ = text
    return command


RUNS = {
    "run": (None, "Run an experiment of any kind, as its file says.\n\nExample:  labrun run hinge --dry-run"),
    "sweep": (
        "sweep",
        "Measure every condition of a sweep, in shuffled blocks.\n\nExample:  labrun sweep fin-params --dry-run",
    ),
    "track": (
        "track",
        "Close loops: follow a reference with each controller.\n\nExample:  labrun track force-control --dry-run",
    ),
    "cmaes": (
        "cmaes",
        "Search by CMA-ES; the winner is confirmed by fresh repeats.\n\n"
        "Example:  labrun cmaes turn-torque --dry-run",
    ),
}
"""The commands that run an experiment: the kind they are for, and their help."""


def design(
    name: options.Name,
    dry_run: options.DryRun = False,
    overrides: options.Overrides = None,
    seed: options.Seed = None,
    limit: Annotated[
        int | None,
        typer.Option(min=1, help="Stop after this many simulated candidates; `labrun resume` continues."),
    ] = None,
    workers: options.Workers = None,
    cluster: options.Cluster = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Search geometry and gait in one, on a simulation: dimensions, drawing, and an experiment on the rig of it.

    Example:  labrun design swimmer --dry-run
    """
    with reported(as_json):
        from labrun.app.design import design as find_design

        result = find_design(
            name,
            dry_run=dry_run,
            overrides=overrides or (),
            seed=seed,
            limit=limit,
            workers=workers,
            cluster=cluster,
            results=results,
            progress=progress_display(),
        )
        print_result(result, as_json)


def resume(
    run: Annotated[
        str | None, typer.Argument(help="Run folder; the latest unfinished run if not given.")
    ] = None,
    limit: options.Limit = None,
    results: options.Results = options.RESULTS,
    accept_changed_spec: Annotated[
        bool,
        typer.Option("--accept-changed-spec", help="Go on although the experiment file has changed since."),
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Go on with an interrupted run, to the same final result.

    Example:  labrun resume
    """
    with reported(as_json):
        from labrun.app.resume import resume as resume_run

        result = resume_run(
            run,
            progress=progress_display(),
            accept_changed_spec=accept_changed_spec,
            limit=limit,
            results=results,
            draw=True,
        )
        print_result(result, as_json)


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


def progress_display() -> "Progress":
    """Return the progress display of a run on standard error."""
    if to_terminal():
        from labrun.report import LiveProgress

        return LiveProgress()
    from labrun.report import PlainProgress

    return PlainProgress()


COMMANDS = {
    "check": check,
    **{name: _command(kind, text) for name, (kind, text) in RUNS.items()},
    "design": design,
    "resume": resume,
    "watch": watch,
}
