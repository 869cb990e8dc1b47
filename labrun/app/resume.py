"""Resume a run."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from labrun.app.carry_out import carry_out, fitted, interruptible, require_answer
from labrun.app.design import go_on as design_on
from labrun.app.design import simulator_of
from labrun.app.run import behind_the_drivers, connected, who_mounts
from labrun.blind import concealed, is_sealed, read_seal
from labrun.errors import LabrunError, RequestError
from labrun.experiment import load_experiment, loads_experiment
from labrun.interrupts import Interrupted, handled
from labrun.runner import Progress, RealClock, Rig, SilentProgress, SimulatedClock
from labrun.search import RunResult, resume_line, stored_result
from labrun.store import RunFolder, find_unfinished, is_finished

_MOST_CHANGES = 8


def resume(
    run: str | Path | None = None,
    *,
    accept_changed_spec: bool = False,
    limit: int | None = None,
    results: str | Path = "results",
    progress: Progress | None = None,
    draw: bool = True,
    person: Callable[[str], str] | None = None,
) -> RunResult:
    """Resume a run by replay: stored trials are read, missing ones are run.

    Parameters
    ----------
    run
        The run's folder; the latest unfinished run if None. Of one that is finished the result is returned.
    accept_changed_spec
        Go on although the experiment file has changed. The run keeps the specification it began with (its
        spec.toml): trials of two specifications in one run would answer no question.
    limit
        Stop after so many new trials.
    results
        Where runs are.
    progress
        Who is told how it goes; nobody if None.
    draw
        Whether the finished run gets its picture.
    person
        See `labrun.app.run.who_mounts`.

    Raises
    ------
    RequestError
        The experiment file has changed since (says which keys), the folder is no run, or an imported recording.
    """
    path = find_unfinished(None if run is None else str(run), Path(results))
    with (
        handled() as interrupts,
        interrupts.held(),
        SilentProgress() if progress is None else progress as reporter,
    ):
        try:
            return _go_on(path, reporter, accept_changed_spec, limit, draw, person)
        except Interrupted as error:
            error.hint = error.hint or f"to continue: {resume_line(path)}"
            raise


def _go_on(
    run: Path,
    progress: Progress,
    accept_changed_spec: bool,
    limit: int | None,
    draw: bool,
    person: Callable[[str], str] | None,
) -> RunResult:
    with interruptible():
        folder = RunFolder.open(run)
        result = stored_result(run)
    if result is not None:
        if not is_finished(run):  # killed between the result and the journal's last line
            folder.journal.append("finished")
        progress.note(f"{run} is finished; nothing was left to do")
        return require_answer(result, loads_experiment(folder.spec_toml, run.parent.name).experiment)
    origin = folder.provenance
    if "imported_from" in origin:
        raise RequestError(
            f"{run} is a recording made elsewhere, imported from {origin['imported_from']}: nothing is left to resume",
            hint=f"labrun show {run} shows it",
        )
    with interruptible():
        changes = changed_keys(origin)
        if changes:
            _refuse_or_note(run, origin, changes, accept_changed_spec, progress)
        loaded = loads_experiment(folder.spec_toml, run.parent.name)
    if loaded.experiment.kind == "design":
        folder.journal.append("resumed", changed=changes)
        simulator = simulator_of(loaded.experiment, Path(str(origin.get("experiment_file", ""))))
        return design_on(
            simulator, folder, seed=int(origin["seed"]), workers=None, cluster=None, limit=limit,
            workspace=Path(), progress=progress, draw=draw,
        )  # fmt: skip
    on_bench = loaded.experiment
    if is_sealed(origin):
        on_bench = concealed(on_bench, read_seal(run, origin).hidden())
    seed, dry_run = int(origin["seed"]), bool(origin["dry_run"])
    clock = SimulatedClock() if dry_run else RealClock()
    emulate = bool(origin.get("emulated", False))
    mounts = who_mounts(on_bench, simulated=dry_run or emulate, person=person)
    with (
        folder.lock(),
        behind_the_drivers(on_bench, seed=seed, emulate=emulate, progress=progress) as emulated,
    ):
        with interruptible():
            rig = Rig.build(on_bench, clock=clock, seed=seed, dry_run=dry_run, emulated=emulated)
        with connected(rig):
            folder.journal.append("resumed", changed=changes)
            if emulated is not None:
                emulated.keep_logs(run / "emulated")
            result = carry_out(
                loaded.experiment,
                rig,
                folder,
                seed=seed,
                limit=limit,
                progress=progress,
                draw=draw,
                person=mounts,
            )
    return fitted(result, loaded.experiment, progress)


def changed_keys(origin: Mapping[str, Any]) -> list[str]:
    """Return what differs between the experiment file as it was read and as it is now, one line a key.

    Comments and layout are no change; a file that is gone cannot be compared and counts as unchanged.
    """
    path, before = Path(origin.get("experiment_file", "")), origin.get("experiment_text")
    if before is None or not path.is_file() or path.read_text(encoding="utf-8") == before:
        return []
    try:
        now = load_experiment(path).experiment
    except LabrunError as error:
        return [f"it does not load any more: {error}"]
    old = loads_experiment(before, path.stem, relative_to=path).experiment
    return list(_differences(old.model_dump(by_alias=True), now.model_dump(by_alias=True)))


def _differences(old: Any, new: Any, key: str = "") -> Iterator[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        for name in dict.fromkeys((*old, *new)):
            inner = f"{key}.{name}" if key else str(name)
            yield from _differences(old.get(name), new.get(name), inner)
    elif old != new:
        yield f"{key}: {old!r} then, {new!r} now"


def _refuse_or_note(
    run: Path, origin: Mapping[str, Any], changes: list[str], accept: bool, progress: Progress
) -> None:
    path = origin["experiment_file"]
    if accept:
        progress.note(f"{path} has changed since; continuing with the stored experiment")
        return
    listed = "".join(f"\n    {change}" for change in changes[:_MOST_CHANGES])
    more = f"\n    and {len(changes) - _MOST_CHANGES} more" if len(changes) > _MOST_CHANGES else ""
    raise RequestError(
        f"{path} has changed since this run began:{listed}{more}",
        hint=f"{resume_line(run)} --accept-changed-spec continues with the stored experiment; "
        "a new run uses the changed file",
    )
