"""Arguments and options that several commands share, with their shell completion."""

from pathlib import Path
from typing import Annotated

import typer


def complete_experiment(ctx: typer.Context, incomplete: str) -> list[str]:
    """Offer the experiments of this workspace and those that ship with labrun; of its kind to `labrun sweep`, say."""
    from labrun.spec import summarise_workspace

    kind = ctx.info_name if ctx.info_name in ("sweep", "track", "cmaes", "design") else None
    found = summarise_workspace(Path.cwd(), RESULTS)
    return sorted({one.name for one in found if one.name.startswith(incomplete) and kind in (None, one.kind)})


Name = Annotated[
    str,
    typer.Argument(
        help="Experiment: its name, or the path of its TOML file.", autocompletion=complete_experiment
    ),
]
_TARGET = "An experiment's name (its latest run), a run folder or run.h5, or a recording's name or folder"
Target = Annotated[str, typer.Argument(help=f"{_TARGET}.", autocompletion=complete_experiment)]
TargetOrRobot = Annotated[
    str,
    typer.Argument(
        help=f"{_TARGET}; with --log, a robot's MJCF or URDF file.", autocompletion=complete_experiment
    ),
]
LatestTarget = Annotated[
    str | None,
    typer.Argument(help=f"{_TARGET}; the latest run if not given.", autocompletion=complete_experiment),
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
RobotModel = Annotated[
    str | None,
    typer.Option(
        "--model",
        help="Of a log: the robot's MJCF or URDF file, or a model that its columns are matched with.",
    ),
]
Mapping = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="CHANNEL=COLUMN",
        help="Of a log: which column a channel or joint is, or none; repeatable.",
    ),
]
Unit = Annotated[
    str | None,
    typer.Option(
        "--unit",
        help="Of a log's angles: rad, deg, ticks (ticks:16384 a turn) or normalised; told from their range.",
    ),
]
Cut = Annotated[
    str | None,
    typer.Option("--cut", metavar="10s", help="Of a log: length of the trials; at rests if not given."),
]
Rate = Annotated[
    float | None, typer.Option("--rate", min=1e-3, help="Of a log without stamps: samples a second.")
]


def seconds(text: str | None) -> float | None:
    """Return a time such as 10s, 10 s, 10 or 2min; None for None.

    Raises
    ------
    RequestError
        It is none.
    """
    if text is None:
        return None
    number, unit_s = (
        (text.strip().removesuffix("min"), 60.0) if "min" in text else (text.strip().removesuffix("s"), 1.0)
    )
    try:
        return float(number) * unit_s
    except ValueError:
        from labrun.errors import RequestError

        raise RequestError(f"--cut {text} is no time", hint="--cut 10s, or --cut 2min") from None


Results = Annotated[Path, typer.Option(help="Folder of the runs.", file_okay=False)]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, for scripts.")]
RESULTS = Path("results")
Workers = Annotated[
    int | None, typer.Option(min=1, help="Processes to compute with; one per core if not given.")
]
Cluster = Annotated[
    str | None,
    typer.Option("--cluster", metavar="ADDRESS", help="Dask scheduler to compute on, e.g. tcp://host:8786."),
]
