"""`labrun gap diagnose`, `save`, `export`, `test`, `compare`, `check-fit`, `plan` and `next`."""

import signal
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from labrun.cli import blind, options
from labrun.cli.output import print_json, print_result, reported, status
from labrun.interrupts import exit_code

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


class SimulatorName(StrEnum):
    """What a diagnosis can be exported to."""

    MJCF = "mjcf"


Model = Annotated[
    str | None,
    typer.Option(
        help="The model (TOML file, plugin, package.module:object, or a name: this workspace's own model comes before "
        "the shipped one); that which the experiment or the recording names if not given."
    ),
]
ExperimentFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Experiment file to write; in experiments/ if not given.", dir_okay=False
    ),
]
More = Annotated[
    list[str] | None,
    typer.Option("--with", metavar="TARGET", help="A further run or recording of the same body; repeatable."),
]


def _effect_ids(incomplete: str) -> list[str]:
    from labrun.effects import effects

    return sorted({effect.id for effect in effects() if effect.id.startswith(incomplete)})


def _numbers(text: str | None, option: str) -> tuple[float, ...] | None:
    """Return numbers separated by commas; None where nothing is given."""
    from labrun.errors import RequestError

    try:
        return None if text is None else tuple(float(part) for part in text.split(","))
    except ValueError:
        raise RequestError(
            f"{option} {text}: numbers separated by commas were expected", hint=f"{option} 0.1,0.5,2"
        ) from None


def _sizes(given: Sequence[str]) -> dict[str, float]:
    """Return ``OUTPUT=SIZE`` by output."""
    from labrun.errors import RequestError

    try:
        return {name.strip(): float(size) for name, size in (text.split("=") for text in given)}
    except ValueError:
        raise RequestError(
            f"--noise {' '.join(given)}: an output and a number were expected", hint="--noise angle=0.002"
        ) from None


@options.with_log_options
def diagnose(
    target: options.TargetOrRobot,
    model: Model = None,
    log: Annotated[
        list[Path] | None,
        typer.Option(
            help="A robot's log: TARGET is then its MJCF or URDF file. What `labrun import` reads; repeatable."
        ),
    ] = None,
    log_answers: options.LogAnswersGiven = options.log_answers,
    anyway: Annotated[
        bool,
        typer.Option(
            "--anyway",
            help="Go on where the robot as stated misses a joint's goals by far more than it moves.",
        ),
    ] = False,
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
    within: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="End with the best answer so far after this time, such as 5min or 90s."
        ),
    ] = None,
    save_model: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the corrected model.", dir_okay=False)
    ] = None,
    explain_rest: Annotated[
        bool,
        typer.Option(
            "--explain-rest",
            help="Propose a law for what the library lacks, as an effect in TOML; refit with it.",
        ),
    ] = False,
    whole: Annotated[
        bool,
        typer.Option(
            "--whole", help="Of a robot's log: fit all joints at once, not joint by joint; far slower."
        ),
    ] = False,
    report: Annotated[bool, typer.Option(help="Write the page and its picture.")] = True,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of resamples and simulated noise; 0 if not given.")
    ] = None,
    workers: options.Workers = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Say where a model and measurements differ, which effect causes it, how far it closes the gap.

    Prints the verdict in at most 20 lines and writes a page with pictures. Says so where the data cannot tell.

    Example:  labrun gap diagnose hinge

    Example:  labrun gap diagnose arm.xml --log run.mcap

    Example:  labrun gap diagnose recordings/ring-down --model pendulum.toml --save-model corrected.toml
    """
    with reported(as_json, "; no diagnosis was written"):
        from labrun.app.diagnose import StoredDiagnosis
        from labrun.app.diagnose import diagnose as diagnose_target
        from labrun.app.diagnose_robot import StoredRobotDiagnosis, diagnose_joints, joint_by_joint

        if log:
            from labrun.app.logs import import_log

            made = import_log(log, target, answers=log_answers())
            target = str(made.folder)
            if not as_json:
                typer.echo(made.to_text(), err=True)
        if not (model or more or anyway):
            from labrun.app.check_recording import require_near

            require_near(target, results=results)
        apart = not (whole or model or more or explain_rest)
        why_together = joint_by_joint(target, results) if apart else None
        if why_together and log and not as_json:
            typer.echo(f"not joint by joint: {why_together}", err=True)
        stored: StoredDiagnosis | StoredRobotDiagnosis
        with status() as note:
            if why_together == "":
                stored = diagnose_joints(
                    target, withhold=withhold or (), within_s=options.seconds(within), seed=seed, workers=workers,
                    save_model=save_model,
                    page=report, results=results, note=note,
                )  # fmt: skip
            else:
                stored = diagnose_target(
                    target, model=model, more=more or (), withhold=withhold or (),
                    within_s=options.seconds(within), seed=seed, workers=workers,
                    save_model=save_model, explain_rest=explain_rest,
                    page=report, results=results, note=note,
                )  # fmt: skip
        if as_json:
            print_json(stored.to_json())
        else:
            from rich.console import Console

            console = Console(highlight=False, markup=False, emoji=False)
            for line in stored.to_text():
                console.print(line, soft_wrap=True)
        if stored.warning:
            typer.echo(f"labrun: {stored.warning}", err=True)
        if stored.was_interrupted:
            raise typer.Exit(exit_code(signal.SIGINT))


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


def test(
    model: Annotated[
        str, typer.Argument(help="The model, a corrected one for instance (see `labrun gap save`).")
    ],
    fresh: Annotated[
        str,
        typer.Option(
            metavar="TARGET",
            help="The run or recording that it was not fitted to: an experiment's name (its latest run), a run folder "
            "or run.h5, or a recording's name or folder.",
            autocompletion=options.complete_experiment,
        ),
    ],
    horizon: Annotated[
        str | None,
        typer.Option(
            metavar="S,S,...",
            help="How far ahead to predict, s; 0.1,0.5,2 as far as the trials reach if not given.",
        ),
    ] = None,
    baseline: Annotated[
        str | None,
        typer.Option(
            "--beside", metavar="MODEL", help="The model to compare with; by default the model it came from."
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the resamples; 0 if not given.")] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Say how far a model predicts a recording that nobody fitted, beside the model it came from.

    The error at each horizon and over whole trials, with 95 % intervals by resampling whole trials.

    Example:  labrun gap test corrected.toml --fresh hinge --horizon 0.1,0.5,2
    """
    with reported(as_json):
        from labrun.app.predict_fresh import predict_fresh
        from labrun.report import fresh_text

        horizons_s = _numbers(horizon, "--horizon")
        with status() as note:
            prediction = predict_fresh(
                model,
                fresh,
                horizons_s=horizons_s,
                predictions_of=baseline,
                seed=seed,
                results=results,
                note=note,
            )
        print_result(prediction, as_json, fresh_text)


def compare(
    first: options.Target,
    second: Annotated[
        str, typer.Argument(help="The other one, named likewise.", autocompletion=options.complete_experiment)
    ],
    model: Model = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the starts; 0 if not given.")] = None,
    workers: options.Workers = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Find the parameters and effects that differ between two data sets beyond noise.

    Example:  labrun gap compare recordings/arm-3 recordings/arm-7 --model corrected.toml
    """
    with reported(as_json):
        from labrun.app.compare_units import compare_units
        from labrun.report import units_text

        with status() as note:
            units = compare_units(
                first, second, model=model, seed=seed, workers=workers, results=results, note=note
            )
        print_result(units, as_json, units_text)


def plan(
    model: Annotated[str, typer.Argument(help="The model (TOML file, plugin, package.module:object).")],
    rig: Annotated[
        str,
        typer.Option(
            metavar="EXPERIMENT",
            help="Whose rig, gait and limits the trials are to keep: its name, or the path of its TOML file.",
            autocompletion=options.complete_experiment,
        ),
    ],
    noise: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OUTPUT=SIZE",
            help="Standard deviation of one trial's noise, in the output's unit; 1 % of its motion if not given; "
            "repeatable.",
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Of each trial.")] = 3,
    out: ExperimentFile = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of the conditions looked at; 0 if not given.")
    ] = None,
    workers: options.Workers = None,
    as_json: options.Json = False,
) -> None:
    """Propose trials before any data: which effects they would show, from which size on, and which none can.

    Writes an experiment file, inside the rig's limits.

    Example:  labrun gap plan hinge-pendulum --rig hinge --noise angle=0.002
    """
    with reported(as_json, "; no experiment was written"):
        from labrun.app.next import plan_trials
        from labrun.report import trial_plan_text

        with status() as note:
            trials = plan_trials(
                model, rig, noise=_sizes(noise or ()), repeats=repeats, out=out, seed=seed, workers=workers,
                note=note,
            )  # fmt: skip
        print_result(trials, as_json, trial_plan_text)


def export(
    target: Annotated[
        str,
        typer.Argument(
            metavar="RUN",
            help="A run or recording that was diagnosed, a diagnosis.json, or a corrected model of MuJoCo.",
        ),
    ],
    _to: Annotated[
        SimulatorName, typer.Option("--to", help="Of what kind the file is.")
    ] = SimulatorName.MJCF,
    output: Annotated[Path, typer.Option(help="File to write.", dir_okay=False)] = Path("corrected.xml"),
    ranges: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write intervals for domain randomisation as JSON, with fields of Isaac Lab and mjlab; fits again.",
            dir_okay=False,
        ),
    ] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Write the corrected robot as a file that a simulator loads, and list what that file cannot express.

    Example:  labrun gap export recordings/arm --to mjcf --output corrected.xml
    """
    with reported(as_json, "; nothing was written"):
        from labrun.app.simulators import export_robot

        with status() as note:
            made = export_robot(target, output, ranges=ranges, results=results, note=note)
        print_result(made, as_json)


@options.with_log_options
def check_fit(
    result: Annotated[
        Path,
        typer.Argument(
            help="What another tool found: params_x_hat.yaml or the identified MJCF of mujoco.sysid, YAML or JSON of "
            "PACE or Isaac Lab, or {joint: {armature, damping, frictionloss, kp, delay}}.",
            exists=True,
            dir_okay=False,
        ),
    ],
    robot: Annotated[
        Path, typer.Option("--model", help="The robot's MJCF or URDF file.", exists=True, dir_okay=False)
    ],
    log: Annotated[list[Path], typer.Option(help="The log that was fitted, or another one; repeatable.")],
    log_answers: options.LogAnswersGiven = options.log_answers,
    within: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="End the diagnosis with its best answer so far after this time, such as 5min.",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of resamples; 0 if not given.")] = None,
    workers: options.Workers = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Say which parameters that another tool found hold, and which stand in for something else.

    Diagnoses the log, simulates it with the file as stated, with the other tool's numbers and with what the diagnosis
    says, and takes each number back in turn.

    Example:  labrun gap check-fit fitted.yaml --model arm.xml --log run.mcap
    """
    with reported(as_json):
        from labrun.app.check_fit import check_fit as check_result

        with status() as note:
            checked = check_result(
                result, log, robot, answers=log_answers(), within_s=options.seconds(within), seed=seed,
                workers=workers, results=results, note=note,
            )  # fmt: skip
        print_result(checked, as_json)


def next_(
    target: options.Target,
    model: Model = None,
    more: More = None,
    out: ExperimentFile = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the search; 0 if not given.")] = None,
    results: options.Results = options.RESULTS,
    as_json: options.Json = False,
) -> None:
    """Propose the experiment that best separates what is left, inside the rig's limits.

    Writes an experiment file; says how long it takes and which causes it tells apart.

    Example:  labrun gap next hinge
    """
    with reported(as_json, "; no experiment was written"):
        from labrun.app.next import propose_next

        with status() as note:
            proposal = propose_next(
                target, model=model, more=more or (), out=out, seed=seed, results=results, note=note
            )
        print_result(proposal, as_json)


COMMANDS: dict[str, Callable[..., None]] = {
    "diagnose": diagnose, "save": save, "export": export, "test": test, "compare": compare, "plan": plan,
    "check-fit": check_fit, "next": next_, **blind.COMMANDS,
}  # fmt: skip
for _name, _command in COMMANDS.items():
    gap.command(_name)(_command)
