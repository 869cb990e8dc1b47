"""Which run is meant by what a person types, and what a run's folder holds."""

import tomllib
from pathlib import Path

from labrun.errors import RequestError
from labrun.store.journal import Journal
from labrun.store.recording import is_recording
from labrun.toml import nearest

SPEC = "spec.toml"
PROVENANCE = "provenance.json"
JOURNAL = "journal.jsonl"
TRIALS = "trials"
PACKED = "run.h5"


def find_run(target: str | Path | None, results: Path) -> Path:
    """Return the run a person means.

    Parameters
    ----------
    target
        An experiment's name (its latest run), a run folder, a ``run.h5``, or a run's own name or its four letters; the
        latest run of all if None.

    Returns
    -------
    Path
        A run folder or a ``run.h5``.

    Raises
    ------
    RequestError
        There is none; names what is nearest, or how to make one.
    """
    if target is None:
        runs = all_runs(results)
        if not runs:
            raise RequestError(
                f"no run yet in {results}",
                hint="labrun run hinge --dry-run makes one; labrun list shows more",
            )
        return runs[-1]
    target = str(target)
    given = Path(target).expanduser()
    if given.is_file():
        return given
    if is_run(given):
        return given
    for folder in (results / target, given):
        runs = runs_of(folder)
        if runs:
            return runs[-1]
    own = [run for run in all_runs(results) if run.name == target or run.name.rpartition("-")[2] == target]
    if own:
        return own[-1]
    raise _unknown(target, results)


def find_data(target: str | Path, results: Path) -> Path:
    """Return the run or recording that a person means.

    Parameters
    ----------
    target
        A recording folder, the name of a recording of this workspace or of those that ship with labrun
        (``table-3-2``), or a run as `find_run` takes it.

    Raises
    ------
    RequestError
        There is none; names what is nearest.
    """
    from labrun.experiment import shipped_experiments

    folder = Path(target).expanduser()
    if is_recording(folder):
        return folder
    if len(folder.parts) > 1:
        return find_run(target, results)
    shelves = [path / "recordings" for path in (Path("experiments"), shipped_experiments())]
    named = next((candidate for shelf in shelves if is_recording(candidate := shelf / folder)), None)
    if named is not None:
        return named
    try:
        return find_run(target, results)
    except RequestError as error:
        recordings = {path.parent.name for shelf in shelves for path in shelf.glob("*/recording.toml")}
        near = nearest(str(target), recordings)
        if near is None or str(error.hint).startswith("did you mean"):
            raise
        raise RequestError(str(error.args[0]), hint=f"did you mean the recording {near!r}?") from None


def find_unfinished(target: str | None, results: Path) -> Path:
    """Return the run to go on with: the one named, or the latest that did not finish.

    Raises
    ------
    RequestError
        There is no such run, or all have finished.
    """
    if target is not None:
        run = find_run(target, results)
        return run.parent if run.is_file() else run
    open_runs = [run for run in all_runs(results) if not is_finished(run)]
    if not open_runs:
        raise RequestError(f"no run in {results} waits to be resumed", hint="labrun resume RUN names one")
    return open_runs[-1]


def is_run(folder: Path) -> bool:
    """Tell whether a folder is a run's."""
    return (folder / SPEC).is_file() or (folder / PACKED).is_file()


def is_finished(run: Path) -> bool:
    """Tell whether a run came to its end, by its journal."""
    return any(event["event"] == "finished" for event in Journal(run / JOURNAL).events())


def runs_of(folder: Path) -> list[Path]:
    """Return the runs of one experiment's folder, oldest first."""
    if not folder.is_dir():
        return []
    return sorted((run for run in folder.iterdir() if is_run(run)), key=_age)


def all_runs(results: Path) -> list[Path]:
    """Return every run below `results`, oldest first."""
    if not results.is_dir():
        return []
    return sorted((run for folder in results.iterdir() for run in runs_of(folder)), key=_age)


def _age(run: Path) -> tuple[str, int]:
    # The name tells the second of the start; runs of the same second are told apart by their first file.
    first = run / SPEC if (run / SPEC).is_file() else run / PACKED
    return run.name.rpartition("-")[0], first.stat().st_mtime_ns


def _unknown(target: str, results: Path) -> RequestError:
    from labrun.experiment import list_experiments

    files = {path.stem: path for path in list_experiments(Path.cwd())}
    if target in files:
        return RequestError(
            f"{target} has no run yet in {results}",
            hint=f"labrun {_command(files[target])} {target} --dry-run makes one",
        )
    with_runs = sorted({run.parent.name for run in all_runs(results)})
    parent = Path(target).expanduser().parent
    folders = [str(path) for path in parent.glob("*/") if is_run(path) or is_recording(path) or runs_of(path)]
    near = nearest(target, [*with_runs, *files, *folders])
    if near:
        hint = f"did you mean {near!r}?"
    elif with_runs:
        hint = f"experiments with runs: {', '.join(with_runs)}"
    else:
        hint = f"{results} has no runs yet; labrun list shows the experiments"
    return RequestError(
        f"cannot find the run {target!r}: no such path, and no such experiment or run in {results}", hint=hint
    )


def _command(experiment: Path) -> str:
    try:
        kind = tomllib.loads(experiment.read_text()).get("kind")
    except (OSError, tomllib.TOMLDecodeError):
        return "run"
    return kind if kind in ("sweep", "cmaes") else "run"
