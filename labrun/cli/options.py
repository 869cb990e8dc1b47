"""Arguments and options that several commands share, with their shell completion."""

from collections.abc import Callable
from functools import partial, wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from labrun.app.logs import LogAnswers


def complete_experiment(ctx: typer.Context, incomplete: str) -> list[str]:
    """Offer the experiments of this workspace and those that ship with labrun; of its kind to `labrun sweep`, say."""
    from labrun.experiment import summarise_workspace

    kind = ctx.info_name if ctx.info_name in ("sweep", "track", "cmaes", "design") else None
    workspace = summarise_workspace(Path.cwd(), RESULTS)
    return sorted(
        {
            summary.name
            for summary in workspace
            if summary.name.startswith(incomplete) and kind in (None, summary.kind)
        }
    )


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
    int | None, typer.Option(min=1, help="Stop after this many trials; `labrun resume` continues.")
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
    list[str] | None,
    typer.Option(
        "--unit",
        metavar="[JOINT=]UNIT",
        help="Of a log: unit of all angles or of one joint: rad, deg, ticks (ticks:16384 a turn), normalised, percent, "
        "m, mm; CHANNEL=A:0.9 of a torque logged in amperes, N m per ampere; repeatable.",
    ),
]
Zero = Annotated[
    list[str] | None,
    typer.Option(
        "--zero",
        metavar="JOINT=NUMBER",
        help="Of a log: what it reads at the zero of a joint's model; repeatable.",
    ),
]
Publisher = Annotated[
    list[str] | None,
    typer.Option(
        "--publisher",
        metavar="TOPIC=NUMBER",
        help="Of a log: which of several writers of a topic counts; repeatable.",
    ),
]
TimeColumn = Annotated[
    list[str] | None,
    typer.Option(
        "--time",
        metavar="[ARRAY=]COLUMN",
        help="Of a log: the column that holds time, of all or of one array.",
    ),
]
TimeUnit = Annotated[
    str | None,
    typer.Option("--time-unit", metavar="s|ms|us|ns", help="Of a log: unit of its column of time."),
]
Stamps = Annotated[
    str | None,
    typer.Option(
        "--stamps",
        metavar="own|receipt",
        help="Of a bag: stamps of the messages as they are, or of their receipt.",
    ),
]
Repair = Annotated[
    bool,
    typer.Option(
        "--repair", help="Of a robot file: replace inertias that no body can have by the nearest possible."
    ),
]
Cut = Annotated[
    str | None,
    typer.Option(
        "--cut",
        metavar="10s",
        help="Of a log: length of the trials; its episodes, or between rests, if not given.",
    ),
]
Rate = Annotated[
    float | None, typer.Option("--rate", min=1e-3, help="Of a log without stamps: samples a second.")
]


def log_answers(
    mapping: Mapping = None,
    unit: Unit = None,
    zero: Zero = None,
    publisher: Publisher = None,
    time: TimeColumn = None,
    time_unit: TimeUnit = None,
    stamps: Stamps = None,
    cut: Cut = None,
    rate: Rate = None,
    repair: Repair = False,
) -> "LogAnswers":
    """Return the answers about a log from the command line options."""
    from labrun.app.logs import LogAnswers

    return LogAnswers(
        mapping or (),
        unit or (),
        zero or (),
        publisher or (),
        time or (),
        time_unit,
        stamps,
        rate,
        seconds(cut),
        repair,
    )


LogAnswersGiven = Callable[..., "LogAnswers"]


def with_log_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of `log_answers` in the place of its parameter of that name.

    The command gets a function without parameters there, which returns the answers, or raises RequestError.
    """
    flags = signature(log_answers).parameters
    parameters: list[Parameter] = []
    for parameter in signature(command).parameters.values():
        parameters += flags.values() if parameter.name == "log_answers" else [parameter]

    @wraps(command)
    def called(**given: Any) -> None:
        chosen = {name: given.pop(name) for name in flags}
        command(**given, log_answers=partial(log_answers, **chosen))

    called.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return called


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

        raise RequestError(
            f"invalid duration {text!r} for --cut; write for example --cut 5s or --cut 2min"
        ) from None


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
