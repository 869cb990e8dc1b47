"""`labrun track`."""

import typer

from labrun.cli import options
from labrun.cli.experiment import execute_kind


def track(
    name: options.TrackName,
    dry_run: options.DryRun = False,
    overrides: options.Overrides = None,
    seed: options.Seed = None,
    limit: options.Limit = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Close loops: follow a reference with each controller.

    Example:  labrun track force-control --dry-run
    """
    execute_kind(name, "track", dry_run, overrides, seed, limit, results, as_json)


def register(app: typer.Typer) -> None:
    """Add this module's command."""
    app.command()(track)
