"""Arguments and options that several commands share, with their shell completion."""

from pathlib import Path
from typing import Annotated

import typer


def complete_experiment(incomplete: str) -> list[str]:
    """Offer the experiments of this workspace and those that ship with labrun."""
    from labrun.spec.workspace import list_experiments

    return sorted({path.stem for path in list_experiments(Path.cwd()) if path.stem.startswith(incomplete)})


Name = Annotated[
    str,
    typer.Argument(
        help="Experiment: its name, or the path of its TOML file.", autocompletion=complete_experiment
    ),
]
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
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a key of the file, e.g. trial.repeats=5; repeatable."
    ),
]
Seed = Annotated[int | None, typer.Option(help="Seed of all randomness; drawn and stored if not given.")]
Limit = Annotated[
    int | None, typer.Option(min=1, help="Stop after this many trials; `labrun resume` goes on.")
]
Results = Annotated[Path, typer.Option(help="Folder of the runs.", file_okay=False)]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, for scripts.")]
RESULTS = Path("results")
