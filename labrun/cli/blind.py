"""`labrun gap check` and `labrun gap reveal`: score the diagnosis on sealed effects."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_result, reported, status


def check(
    cases: Annotated[int, typer.Option(min=1, help="How many cases.")] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Of the cases.")] = 0,
    only: Annotated[
        str | None,
        typer.Option(
            metavar="KIND",
            help="Cases of one kind, not the mixture: control, effect, pair, parameter or outside; robots: arms and "
            "legs of 6 to 12 joints with effects hidden in one to three, diagnosed joint by joint.",
        ),
    ] = None,
    data: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE",
            help="What all recordings are like, not drawn: repeats=N, conditions=N, noise=white (ar1, counts, "
            "pink), zeros, no-zeros; repeatable.",
        ),
    ] = None,
    tool: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COMMAND",
            help="Score another program on the same cases, beside labrun: it gets the folder of a case as its last "
            "argument and prints JSON with gap, causes and rest; repeatable.",
        ),
    ] = None,
    tool_limit_s: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Time that a tool may take for one case; 120 if not given."),
    ] = None,
    workers: options.Workers = None,
    cluster: options.Cluster = None,
    generator: Annotated[
        Path | None,
        typer.Option(help="Folder of the code that makes the cases.", file_okay=False, exists=True),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the cases and their scores.", file_okay=False)
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Diagnose cases whose hidden effect the diagnosis is not told, then score it.

    The answers are sealed first: their salted hash is printed before anything is diagnosed. Every case is listed.

    Example:  labrun gap check --cases 20 --seed 7

    Example:  labrun gap check --cases 20 --seed 7 --tool "python my_method.py"
    """
    if only is not None and only.removesuffix("s") == "robot":
        _check_robots(
            cases, seed, workers, out, as_json=as_json, other=bool(data or cluster or generator or tool)
        )
        return
    with reported(as_json):
        from labrun.blind import check as check_cases
        from labrun.report import check_text, write_check_page

        with status() as note:
            result = check_cases(
                cases=cases,
                seed=seed,
                only=only,
                data=data or (),
                workers=workers,
                cluster=cluster,
                generator=generator,
                out=out,
                tools=tool or (),
                tool_limit_s=tool_limit_s,
                note=note,
            )
        write_check_page(result)
        print_result(result, as_json, check_text)


def _check_robots(
    cases: int, seed: int, workers: int | None, out: Path | None, *, as_json: bool, other: bool
) -> None:
    with reported(as_json):
        from labrun.blind import check_robots
        from labrun.errors import RequestError

        if other:
            raise RequestError("--data, --tool, --cluster and --generator are not for --only robots")
        with status() as note:
            result = check_robots(cases=cases, seed=seed, workers=workers, out=out, note=note)
        print_result(result, as_json)


def reveal(
    target: Annotated[
        str,
        typer.Argument(
            metavar="RUN",
            help="A run that was made with --hide and diagnosed: an experiment's name (its latest run), or the "
            "run's folder.",
            autocompletion=options.complete_experiment,
        ),
    ],
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Open the seal of a dry run that hid an effect, beside what its diagnosis said.

    Example:  labrun gap reveal hinge
    """
    with reported(as_json):
        from labrun.app.diagnose import reveal as open_seal
        from labrun.report import compared_text

        compared = open_seal(target, results=results)
        print_result(compared, as_json, compared_text)


COMMANDS: dict[str, Callable[..., None]] = {"check": check, "reveal": reveal}
