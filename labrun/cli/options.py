"""Arguments and options that several commands share, with their shell completion."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer


def complete_experiment(incomplete: str) -> list[str]:
    """Offer the experiments of this workspace and those that ship with labrun."""
    from labrun.spec.workspace import list_experiments

    return sorted({path.stem for path in list_experiments(Path.cwd()) if path.stem.startswith(incomplete)})


def complete_of_kind(kind: str) -> Callable[[str], list[str]]:
    """Return a completion that offers the experiments of one kind."""

    def complete(incomplete: str) -> list[str]:
        from labrun.spec.listing import summarise_workspace

        summaries = summarise_workspace(Path.cwd(), RESULTS)
        return [item.name for item in summaries if item.kind == kind and item.name.startswith(incomplete)]

    return complete


_NAME = "Experiment: its name, or the path of its TOML file."
Name = Annotated[str, typer.Argument(help=_NAME, autocompletion=complete_experiment)]
SweepName = Annotated[str, typer.Argument(help=_NAME, autocompletion=complete_of_kind("sweep"))]
CmaesName = Annotated[str, typer.Argument(help=_NAME, autocompletion=complete_of_kind("cmaes"))]
TrackName = Annotated[str, typer.Argument(help=_NAME, autocompletion=complete_of_kind("track"))]
Target = Annotated[
    str,
    typer.Argument(
        help="An experiment's name (its latest run), a run folder or run.h5, or a recording folder.",
        autocompletion=complete_experiment,
    ),
]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Simulated devices in simulated time; nothing moves.")
]
Emulate = Annotated[
    bool,
    typer.Option(
        "--emulate",
        help="The real drivers in real time, against emulators of the devices; nothing real moves.",
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a key of the file, e.g. trial.repeats=5; repeatable."
    ),
]
Seed = Annotated[
    int | None, typer.Option(min=0, help="Seed of all randomness; drawn and stored if not given.")
]
Limit = Annotated[
    int | None, typer.Option(min=1, help="Stop after this many trials; `labrun resume` goes on.")
]
Hide = Annotated[
    list[str] | None,
    typer.Option(
        "--hide",
        metavar="WHAT",
        help=(
            "Dry run: hide an effect in the bench and seal which: random, none, EFFECT@SITE[:name=value,...], "
            "PARAMETER=value, or same-as:RUN for the bench of an earlier run."
        ),
    ),
]
HideSeed = Annotated[
    int | None, typer.Option("--hide-seed", min=0, help="Seed of --hide random, for tests.", hidden=True)
]
Results = Annotated[Path, typer.Option(help="Folder of the runs.", file_okay=False)]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, for scripts.")]
RESULTS = Path("results")
