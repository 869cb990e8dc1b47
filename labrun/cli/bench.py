"""`labrun plugins`, `labrun doctor`."""

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


def doctor(as_json: options.Json = False) -> None:
    """Check machine and ports: latency, permissions, clock.

    Example:  labrun doctor
    """
    with reported(as_json):
        from labrun.runner.doctor import examine

        findings = examine()
    if as_json:
        print_json({"findings": [finding.to_json() for finding in findings]})
        return
    for finding in findings:
        typer.echo(f"{finding.verdict:<8} {finding.subject}: {finding.message}")
        if finding.advice:
            typer.echo(f"         -> {finding.advice}")


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command()(plugins)
    app.command()(doctor)
