"""`labrun fit`, `compare` and `rank`."""

from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.experiment import progress_display
from labrun.cli.output import print_result, reported, status


def fit(
    target: options.Target,
    recording: Annotated[
        str | None,
        typer.Argument(help="A run or recording to fit in the way the experiment TARGET declares."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="A model (TOML file, plugin, package.module:object, or a name: this workspace's own model comes "
            "before the shipped one), or a fit by name: least-squares, fopdt, transfer-function, pid."
        ),
    ] = None,
    more: Annotated[
        list[str] | None,
        typer.Option("--with", metavar="TARGET", help="A further run of the same fit; repeatable."),
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A setting of the fit, e.g. poles=2; repeatable."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="First make a dry run of the experiment TARGET, then fit that.")
    ] = False,
    seed: options.Seed = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Fit a model to a run or a recording.

    Prints parameters with 95 % intervals, the error per channel, and the path of a figure.

    Example:  labrun fit hinge

    Example:  labrun fit recordings/ring-down --model recordings/ring-down/model.toml
    """
    with reported(as_json):
        from labrun.app.fit import fit as fit_data

        if dry_run:
            from labrun.app.run import run

            made = run(target, dry_run=True, seed=seed, results=results, progress=progress_display())
            target = str(made.run)
        with status() as note:
            result = fit_data(
                target,
                recording,
                more=more or (),
                model=model,
                overrides=overrides or (),
                seed=seed,
                results=results,
                note=note,
            )
        print_result(result, as_json)


def compare(
    target: options.Target,
    other: Annotated[
        str | None,
        typer.Argument(
            help="What is held against it: another run or recording, named likewise. A model is, if not given.",
            autocompletion=options.complete_experiment,
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="The model (TOML file, plugin, package.module:object, or a name: this workspace's own model comes "
            "before the shipped one); that which the experiment or the recording names if not given."
        ),
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE", help="Greatest relative error, such as 15%; exit code 1 if a point is beyond it."
        ),
    ] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Hold a prediction as stated, or another run, against data. Nothing is fitted.

    Prints every condition, the worst first, and the error of each channel; draws a figure.

    Example:  labrun compare hinge --model hinge-pendulum --tolerance 15%

    Example:  labrun compare hinge recordings/ring-down

    Example:  labrun compare design:swimmer rig:rowing --tolerance 10%
    """
    with reported(as_json, "; no comparison was written"):
        from labrun.app.compare import compare as compare_data

        with status() as note:
            stored = compare_data(target, other, model=model, tolerance=tolerance, results=results, note=note)
        print_result(stored, as_json)
    if not stored.within:
        raise typer.Exit(1)


def rank(
    laboratories: Annotated[
        list[str],
        typer.Argument(
            help="Runs in which the gaits were measured: an experiment's name (its latest run) or a run folder.",
            autocompletion=options.complete_experiment,
        ),
    ],
    field: Annotated[
        str,
        typer.Option(
            help="The run in the field, named likewise.", autocompletion=options.complete_experiment
        ),
    ],
    objective: Annotated[
        str | None, typer.Option(help="Of the field; the one with a goal, or the first, if not given.")
    ] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Hold the order of gaits in the laboratory against that in the field, and name the gait to take.

    Prints every gait at each setting, the rank correlation with its interval and p, and why that gait.

    Example:  labrun rank turn-torque turn-torque-current --field field-turn
    """
    with reported(as_json, "; no ranking was written"):
        from labrun.app.rank import rank as rank_gaits
        from labrun.report import ranking_text

        gaits = rank_gaits(laboratories, field, objective=objective, results=results)
        print_result(gaits, as_json, ranking_text)


COMMANDS = {"fit": fit, "compare": compare, "rank": rank}
