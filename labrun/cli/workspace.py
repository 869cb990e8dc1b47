"""Workspace commands: `labrun init`, `list`, `keys`, `new`, `plugins`, `doctor`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported


class NewKind(StrEnum):
    """What a new file can be for."""

    RUN = "run"
    SWEEP = "sweep"
    CMAES = "cmaes"
    TRACK = "track"


def init(
    directory: Annotated[Path, typer.Argument(help="Where; made if absent.", file_okay=False)] = Path(),
    as_json: options.Json = False,
) -> None:
    """Make a workspace with the shipped experiments.

    Example:  labrun init my-bench
    """
    with reported(as_json):
        from labrun.experiment import create_workspace

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
        from labrun.experiment import summarise_workspace

        summaries = summarise_workspace(Path.cwd(), results)
    if as_json:
        print_json({"experiments": summaries})
        return
    width = max((len(summary.name) for summary in summaries), default=0)
    for summary in summaries:
        runs = f"{summary.runs} run{'s' if summary.runs != 1 else ''}" if summary.runs else ""
        typer.echo(f"{summary.name:<{width}}  {summary.kind:<6} {runs:>8}  {summary.title}")


def keys(
    path: Annotated[
        str,
        typer.Argument(
            metavar="KEY",
            help="A key or table such as trial.settle, or a plugin such as dynamixel; without it, the top of the file.",
        ),
    ] = "",
    as_json: options.Json = False,
) -> None:
    """Say what a key of an experiment file takes, its default and its unit.

    Example:  labrun keys trial.settle
    """
    with reported(as_json):
        from labrun.experiment import keys_at

        listed = keys_at(path)
    if as_json:
        print_json({"keys": listed})
        return
    from labrun.report import keys_text

    typer.echo(keys_text(listed))


def new(
    name: Annotated[str, typer.Argument(help="Of the experiment; the file is experiments/NAME.toml.")],
    devices: Annotated[
        str, typer.Option(metavar="PLUGIN,...", help="Drivers of the bench, e.g. dynamixel,ati-netft.")
    ],
    kind: Annotated[NewKind, typer.Option(help="What the experiment does.")] = NewKind.SWEEP,
    as_json: options.Json = False,
) -> None:
    """Write a commented experiment file for some devices, which checks and dry-runs at once.

    Example:  labrun new my-arm --devices dynamixel,ati-netft
    """
    with reported(as_json):
        from labrun.experiment import new_experiment

        plugins = [plugin.strip() for plugin in devices.split(",") if plugin.strip()]
        path = new_experiment(name, plugins, kind.value, Path("experiments"))
    if as_json:
        print_json({"experiment": path})
        return
    typer.echo(f"wrote {path}")
    typer.echo(f"next:  labrun run {path.stem} --dry-run")


def plugins(as_json: options.Json = False) -> None:
    """List all plugins with their origin and state.

    Example:  labrun plugins
    """
    with reported(as_json):
        from labrun.registry import inspect_all

        plugins_ = inspect_all()
    if as_json:
        print_json({"plugins": plugins_})
        return
    width = max((len(entry.name) for entry in plugins_), default=0)
    group = ""
    for entry in plugins_:
        if entry.group != group:
            group = entry.group
            typer.echo(f"\n{group}" if group != plugins_[0].group else group)
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
        from labrun.app.doctor import examine
        from labrun.report import remark_text

        remarks = examine(experiment, Path.cwd(), overrides or (), hardware=hardware, emulate=emulate)
        diagnosed = []
        for remark in remarks:
            diagnosed.append(remark)
            if not as_json:
                typer.echo(remark_text(remark))
    if as_json:
        print_json({"findings": [remark.to_json() for remark in diagnosed]})
    if any(remark.verdict == "problem" for remark in diagnosed):
        raise typer.Exit(1)


COMMANDS = {"init": init, "list": list_, "keys": keys, "new": new, "plugins": plugins, "doctor": doctor}
