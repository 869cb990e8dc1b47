"""`labrun fit`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from labrun.cli import options
from labrun.cli.experiment import progress_display
from labrun.cli.output import print_result, reported, to_terminal


def fit(
    target: options.Target,
    recording: Annotated[
        str | None,
        typer.Argument(help="A run or recording to fit in the way the experiment TARGET declares."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="A model (TOML file, plugin, package.module:object), or a fit by name: "
            "least-squares, fopdt, transfer-function, pid."
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
        with _status() as note:
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


@contextmanager
def _status() -> Iterator[Callable[[str], None]]:
    """Say on one line what is being done, where a person is watching."""
    if not to_terminal():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.markup import escape

    with Console(stderr=True).status("reading") as status:
        yield lambda text: status.update(escape(text))


COMMANDS = {"fit": fit}
