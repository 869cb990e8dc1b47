"""`labrun check`, `run`, `sweep`, `track`, `cmaes`, `resume`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported, to_terminal

if TYPE_CHECKING:
    from labrun.runner.progress import Progress
    from labrun.search.execute import RunResult


def check(
    name: options.Name,
    dry_run: options.DryRun = False,
    overrides: options.Overrides = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Validate the whole plan: trials, time, disk, limits. Nothing moves.

    Example:  labrun check fin-params --set trial.repeats=5
    """
    with reported(as_json):
        from labrun.search.execute import check as check_plan
        from labrun.spec.named import load_named

        plan = check_plan(load_named(name, Path.cwd(), overrides or ()), dry_run=dry_run)
        if as_json:
            print_json(plan.report())
            raise typer.Exit(2 if plan.excess else 0)
        from labrun.report.plan_text import plan_text

        typer.echo(plan_text(plan, results))
        plan.require_feasible()


def run(
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
    """Run an experiment of any kind, as its file says.

    Example:  labrun run hinge --dry-run
    """
    _execute(name, None, dry_run, emulate, overrides, seed, limit, results, as_json, hide, hide_seed)


def sweep(
    name: options.SweepName,
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
    """Measure every condition of a sweep, in shuffled blocks.

    Example:  labrun sweep fin-params --dry-run
    """
    _execute(name, "sweep", dry_run, emulate, overrides, seed, limit, results, as_json, hide, hide_seed)


def track(
    name: options.TrackName,
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
    """Close loops: follow a reference with each controller.

    Example:  labrun track force-control --dry-run
    """
    _execute(name, "track", dry_run, emulate, overrides, seed, limit, results, as_json, hide, hide_seed)


def cmaes(
    name: options.CmaesName,
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
    """Search by CMA-ES; the winner is confirmed by fresh repeats.

    Example:  labrun cmaes turn-torque --dry-run
    """
    _execute(name, "cmaes", dry_run, emulate, overrides, seed, limit, results, as_json, hide, hide_seed)


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
        from labrun.report.figure import draw_run
        from labrun.search.resume import resume as resume_run
        from labrun.store.locate import find_unfinished

        folder = find_unfinished(run, results)
        with _progress() as progress:
            result = resume_run(
                folder,
                progress=progress,
                accept_changed_spec=accept_changed_spec,
                limit=limit,
                draw=draw_run,
            )
        _print_result(result, as_json)


def _execute(
    name: str,
    kind: str | None,
    dry_run: bool,
    emulate: bool,
    overrides: list[str] | None,
    seed: int | None,
    limit: int | None,
    results: Path,
    as_json: bool,
    hide: list[str] | None,
    hide_seed: int | None,
) -> None:
    """Run an experiment of a kind (None: of any), and print its result."""
    with reported(as_json):
        result = _carried_out(
            name, kind, dry_run, emulate, overrides or [], seed, limit, results, hide or (), hide_seed
        )
        _print_result(result, as_json)


def dry_run_of(name: str, seed: int | None, results: Path) -> Path:
    """Make a dry run of an experiment, and return its folder."""
    return _carried_out(name, None, True, False, [], seed, None, results).run


def _carried_out(
    name: str,
    kind: str | None,
    dry_run: bool,
    emulate: bool,
    overrides: list[str],
    seed: int | None,
    limit: int | None,
    results: Path,
    hide: Sequence[str] = (),
    hide_seed: int | None = None,
) -> "RunResult":
    from labrun.errors import RequestError
    from labrun.report.figure import draw_run
    from labrun.search.execute import execute
    from labrun.spec.named import load_named

    if dry_run and emulate:
        raise RequestError(
            "--dry-run and --emulate exclude each other",
            hint="--dry-run: simulated devices in simulated time; --emulate: real drivers in real time",
        )
    loaded = load_named(name, Path.cwd(), overrides, kind=kind)
    with _progress() as progress:
        return execute(
            loaded, results=results, dry_run=dry_run, emulate=emulate, seed=seed, limit=limit, progress=progress,
            draw=draw_run, hide=hide, hide_seed=hide_seed,
        )  # fmt: skip


def _progress() -> "Progress":
    if to_terminal():
        from labrun.report.progress import LiveProgress

        return LiveProgress()
    from labrun.report.plain_progress import PlainProgress

    return PlainProgress()


def _print_result(result: "RunResult", as_json: bool) -> None:
    if as_json:
        print_json(result.to_json())
    else:
        typer.echo(result.to_text())


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    for command in (check, run, sweep, track, cmaes, resume):
        app.command()(command)
