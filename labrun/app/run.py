"""Start a new run: plan, connect, carry out."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path

import numpy as np

from labrun.app.carry_out import carry_out, fitted, interruptible, source_of
from labrun.app.check import NO_SCENE, require_room, whole_plan
from labrun.app.leaders import missing_beside, with_leaders
from labrun.devices import NoTerminalError, Terminal
from labrun.errors import RequestError
from labrun.experiment import Experiment, LoadedExperiment, load_named, scene_of
from labrun.interrupts import handled
from labrun.objectives import ASKED
from labrun.runner import (
    AutoConfirm,
    EmulatedBench,
    MotionMaker,
    Person,
    Progress,
    RealClock,
    Rig,
    Scripted,
    SilentProgress,
    SimulatedClock,
    has_emulator,
    ports_of,
)
from labrun.search import RunResult
from labrun.store import RunFolder, collect, lock_ports


def run(
    experiment: str | Path | LoadedExperiment,
    *,
    dry_run: bool = False,
    emulate: bool = False,
    overrides: Sequence[str] = (),
    kind: str | None = None,
    seed: int | None = None,
    limit: int | None = None,
    hide: Sequence[str] = (),
    hide_seed: int | None = None,
    results: str | Path = "results",
    workspace: str | Path = ".",
    progress: Progress | None = None,
    draw: bool = True,
    person: Callable[[str], str] | None = None,
) -> RunResult:
    """Run an experiment of any kind: trials, confirmed best, ``run.h5``, figure.

    Parameters
    ----------
    experiment
        Its name, as ``labrun list`` shows it, the path of its TOML file, or one that is loaded already.
    dry_run
        Simulated devices in simulated time.
    emulate
        The real drivers in real time, against emulators of their devices.
    overrides
        Keys of the file to replace, such as ``trial.repeats=5``.
    kind
        What the experiment must be, such as ``"sweep"``; of any kind if None.
    seed
        Of all randomness; drawn if None, and stored with the run.
    limit
        Stop after this many trials; the run can be resumed.
    hide
        Of a dry or emulated run: what its scene hides, see `labrun.blind.hidden_bench`; sealed with the
        run, and told nowhere else. Empty hides nothing and seals nothing.
    hide_seed
        Of what is drawn; drawn itself if None, and stored nowhere.
    results
        Folder of the runs; the run's own is made once all devices have answered.
    workspace
        Where the experiment is looked for.
    progress
        Who is told how it goes; nobody if None.
    draw
        Whether the finished run gets its picture.
    person
        Answers what the person at the bench is asked to set by hand, see `who_mounts`.

    Raises
    ------
    RequestError
        The request or the plan does not hold; nothing moved and nothing was written.
    ExperimentError, Interrupted
        The experiment failed, or was interrupted; the hint says what was saved and how to go on.
    """
    if dry_run and emulate:
        raise RequestError(
            "--dry-run and --emulate exclude each other",
            hint="--dry-run: simulated devices in simulated time; --emulate: real drivers in real time",
        )
    results = Path(results)
    loaded = experiment
    if not isinstance(loaded, LoadedExperiment):
        with interruptible():
            loaded = load_named(str(experiment), Path(workspace), overrides, kind=kind)
    if loaded.experiment.kind == "design":
        from labrun.app.design import design

        return design(
            loaded, dry_run=dry_run and not hide, seed=seed, limit=limit, results=results, workspace=workspace,
            progress=progress, draw=draw,
        )  # fmt: skip
    with (
        handled() as interrupts,
        interrupts.held(),
        SilentProgress() if progress is None else progress as reporter,
    ):
        for name in missing_beside(loaded.experiment, results):
            reporter.note(
                f"no run of {name} in {results} yet: its leaders are not measured beside those of this run"
            )
        with interruptible():
            planned = with_leaders(loaded, results)
        result = _on_bench(
            planned, results, dry_run=dry_run, emulate=emulate, seed=seed, limit=limit,
            hide=hide, hide_seed=hide_seed, progress=reporter, draw=draw, person=person,
        )  # fmt: skip
        return fitted(result, loaded.experiment, reporter, workspace)


def _on_bench(
    loaded: LoadedExperiment,
    results: Path,
    *,
    dry_run: bool,
    emulate: bool,
    seed: int | None,
    limit: int | None,
    hide: Sequence[str],
    hide_seed: int | None,
    progress: Progress,
    draw: bool,
    person: Callable[[str], str] | None,
) -> RunResult:
    on_bench, seal = loaded.experiment, None
    if hide:
        from labrun.blind import (  # brings effects, fits, the diagnosis
            SEALED,
            hidden_bench,
            redacted,
            write_seal,
        )

        with interruptible():
            bench = hidden_bench(loaded, hide, seed=hide_seed, simulated=dry_run or emulate, results=results)
        on_bench, seal = bench.experiment, bench.seal
        seed = bench.seed if seed is None else seed
    if seed is None:
        seed = int(np.random.default_rng().integers(2**32))
    mounts = who_mounts(on_bench, simulated=dry_run or emulate, person=person)
    clock = SimulatedClock() if dry_run else RealClock()
    progress.phase("checking the plan")
    if (dry_run or emulate) and loaded.experiment.rig.scene is None:
        progress.note(NO_SCENE)
    with behind_the_drivers(on_bench, seed=seed, emulate=emulate, progress=progress) as emulated:
        with interruptible():
            rig = Rig.build(on_bench, clock=clock, seed=seed, dry_run=dry_run, emulated=emulated)
            motions = MotionMaker(loaded.experiment)
            plan = whole_plan(loaded, seed, rig, motions)
            plan.require_feasible()
            require_room(plan, results)
        progress.phase("connecting")
        with connected(rig):
            origin = {
                **collect(loaded.path.resolve().parent, seed=seed, devices=rig.identities()),
                **source_of(loaded.path),
                "dry_run": dry_run,
                "emulated": emulate,
            }
            if seal is not None:
                origin |= {SEALED: seal.sha256, "command": redacted(origin["command"])}
            folder = RunFolder.create(results, loaded.name, loaded.resolved_toml, origin)
            if emulated is not None:
                emulated.keep_logs(folder.path / "emulated")
            if seal is not None:
                write_seal(folder.path, seal)
                progress.note(f"sealed what this run hides: sha256 {seal.sha256[:16]}")
            return carry_out(
                loaded.experiment, rig, folder, seed=seed, limit=limit, progress=progress, draw=draw, person=mounts,
                motions=motions,
            )  # fmt: skip


def who_mounts(experiment: Experiment, *, simulated: bool, person: Callable[[str], str] | None) -> Person:
    """Return the person who sets factors by hand.

    Parameters
    ----------
    simulated
        Whether there is nothing to set: a simulated bench has always done it.
    person
        A function that gets each question and returns the answer, "" for yes; the person at the terminal if None.

    Raises
    ------
    RequestError
        Somebody has to be asked, and there is no terminal.
    """
    if person is not None:
        return Scripted(person)
    asked = [name for name, objective in experiment.objectives.items() if objective.plugin == ASKED]
    if (experiment.by_hand is None and not asked) or simulated:
        return AutoConfirm()
    terminal = Terminal()
    try:
        terminal.require()
    except NoTerminalError as error:
        set_by_hand = () if experiment.by_hand is None else experiment.by_hand.names
        parts = ["set " + ", ".join(set_by_hand) + " by hand"] if set_by_hand else []
        parts += ["type " + ", ".join(asked)] if asked else []
        raise RequestError(
            f"somebody has to {' and '.join(parts)}, and {error}: this needs a person at a terminal",
            hint="run labrun in a terminal, without redirecting its input, or from Python: labrun.run(..., person=...)",
        ) from error
    return terminal


@contextmanager
def connected(rig: Rig) -> Iterator[Rig]:
    """Hold every port of a rig and its devices open; a second run on one of the ports is refused.

    Raises
    ------
    RigBusyError
        Another run holds a port; nothing was connected.
    DeviceError
        A device cannot be opened.
    """
    # Emulators' ports are the run's own, and two such runs do not meet.
    settings = [] if rig.dry_run or rig.emulated else [item.settings for item in rig.resolved]
    ports = [port for table in settings for port in ports_of(table)]
    with lock_ports(ports) if ports else nullcontext(), ExitStack() as stack:
        stack.push(rig)  # let go of, whatever happens from here on
        with interruptible(
            " while devices were being connected: actuators are stopped, nothing was recorded"
        ):
            rig.open()
        yield rig


@contextmanager
def behind_the_drivers(
    experiment: Experiment, *, seed: int, emulate: bool, progress: Progress
) -> Iterator[EmulatedBench | None]:
    """Run the emulators of an experiment's devices; yield None if not requested.

    Raises
    ------
    RequestError
        None of the devices has an emulator, so that a dry run would do the same.
    """
    if not emulate:
        yield None
        return
    rig = experiment.rig
    if not any(has_emulator(table.plugin) for table in rig.devices.values()):
        raise RequestError(
            "none of its devices has an emulator",
            hint="--dry-run simulates them; labrun plugins lists the emulators",
        )
    progress.phase("starting the emulators")
    with ExitStack() as stack:
        with interruptible():
            bench = stack.enter_context(EmulatedBench(rig.devices, scene_of(rig), seed=seed))
        yield bench
