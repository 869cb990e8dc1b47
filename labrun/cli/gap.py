"""`labrun gap diagnose`, `save`, `next`, `check`, `reveal`."""

from pathlib import Path
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.output import print_json, reported
from labrun.cli.status import status

gap = typer.Typer(
    name="gap",
    help="Find out where a model and measurements differ, and why.\n\n"
    "Which effect is missing, at which site, and how far the gap closes with it; or that the data cannot tell. Every "
    "command takes --json.\n\n"
    "Example:  labrun gap diagnose hinge",
    no_args_is_help=True,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Model = Annotated[
    str | None,
    typer.Option(
        help="The model (TOML file, plugin, package.module:object); that which the experiment or the recording names "
        "if not given.",
    ),
]
More = Annotated[
    list[str] | None,
    typer.Option("--with", metavar="TARGET", help="A further run or recording of the same body; repeatable."),
]
Workers = Annotated[
    int | None, typer.Option(min=1, help="Processes to compute with; one per core if not given.")
]


def _effect_ids(incomplete: str) -> list[str]:
    from labrun.effects import effects

    return sorted({effect.id for effect in effects() if effect.id.startswith(incomplete)})


def diagnose(
    target: options.Target,
    model: Model = None,
    more: More = None,
    withhold: Annotated[
        list[str] | None,
        typer.Option(
            metavar="EFFECT",
            help="Leave an effect out of the library, and those that contain it, to see whether its absence is "
            "noticed; repeatable.",
            autocompletion=_effect_ids,
        ),
    ] = None,
    full_guard: Annotated[
        bool,
        typer.Option(
            "--full-guard", help="Refit every simulated false alarm instead of estimating it: minutes."
        ),
    ] = False,
    save_model: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the corrected model.", dir_okay=False)
    ] = None,
    report: Annotated[bool, typer.Option(help="Write the page and its picture.")] = True,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of resamples and simulated noise; 0 if not given.")
    ] = None,
    workers: Workers = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Say where a model and measurements differ, which effect causes it, how far it closes the gap.

    Prints the verdict in at most 20 lines and writes a page with pictures. Says so where the data cannot tell.

    Example:  labrun gap diagnose hinge

    Example:  labrun gap diagnose recordings/ring-down --model pendulum.toml --save-model corrected.toml
    """
    with reported(as_json, "interrupted; no diagnosis was written"):
        from labrun.app.diagnose import diagnose as diagnose_target

        with status() as note:
            stored = diagnose_target(
                target,
                model=model,
                more=more or (),
                withhold=withhold or (),
                full_guard=full_guard,
                seed=seed,
                workers=workers,
                save_model=save_model,
                page=report or open_page,
                results=results,
                note=note,
            )
        if as_json:
            print_json(stored.to_json())
        else:
            from rich.console import Console

            console = Console(highlight=False)
            for line in stored.to_text():
                console.print(line, soft_wrap=True)
        if stored.warning:
            typer.echo(f"labrun: {stored.warning}", err=True)
    if open_page:
        typer.launch(str(stored.page))


def save(
    target: Annotated[
        str,
        typer.Argument(
            metavar="RUN",
            help="A run that was diagnosed: an experiment's name (its latest run), or the run's folder.",
            autocompletion=options.complete_experiment,
        ),
    ],
    file: Annotated[Path, typer.Argument(help="The file to write.", dir_okay=False)],
    model: Annotated[
        str | None, typer.Option(help="The model that was diagnosed, if it has moved since.")
    ] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Write the corrected model of the diagnosis that is kept with a run.

    Example:  labrun gap save hinge corrected.toml
    """
    with reported(as_json):
        from labrun.app.diagnose import save as save_stored

        warning = save_stored(target, file, model=model, results=results)
        if as_json:
            print_json({"saved_model": file, "warning": warning or None})
        else:
            typer.echo(f"wrote {file}")
            if warning:
                typer.echo(f"labrun: {warning}", err=True)


def next_(
    target: options.Target,
    model: Model = None,
    more: More = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Experiment file to write; in experiments/ if not given.", dir_okay=False
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the search; 0 if not given.")] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Propose the experiment that best separates what is left, inside the rig's limits.

    Writes an experiment file; says how long it takes and which causes it tells apart.

    Example:  labrun gap next hinge
    """
    with reported(as_json, "interrupted; no experiment was written"):
        from labrun.app.next import propose_next

        with status() as note:
            proposal = propose_next(
                target,
                model=model,
                more=more or (),
                out=out,
                seed=seed,
                results=results,
                note=note,
            )
        if as_json:
            print_json(proposal.to_json())
        else:
            typer.echo(proposal.to_text())


def check(
    cases: Annotated[int, typer.Option(min=1, help="How many cases.")] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Of the cases.")] = 0,
    only: Annotated[
        str | None,
        typer.Option(
            metavar="KIND",
            help="Cases of one kind, not the mixture: control, effect, pair, parameter or outside.",
        ),
    ] = None,
    workers: Workers = None,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler to compute on, e.g. tcp://host:8786."),
    ] = None,
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
    """
    with reported(as_json):
        from labrun.blind import check as check_cases
        from labrun.report.diagnosis_check import check_text, write_check_page

        with status() as note:
            result = check_cases(
                cases=cases,
                seed=seed,
                only=only,
                workers=workers,
                cluster=cluster,
                generator=generator,
                out=out,
                note=note,
            )
        write_check_page(result)
        if as_json:
            print_json(result.to_json())
        else:
            typer.echo(check_text(result))


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
        from labrun.app.reveal import reveal as open_seal
        from labrun.report.gap_reveal import compared_text

        compared = open_seal(target, results=results)
        if as_json:
            print_json(compared.to_json())
        else:
            typer.echo(compared_text(compared))


def register(app: typer.Typer) -> None:
    """Add this module's commands, under ``labrun gap``."""
    gap.command()(diagnose)
    gap.command()(save)
    gap.command("next")(next_)
    gap.command()(check)
    gap.command()(reveal)
    app.add_typer(gap)
