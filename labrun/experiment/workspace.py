"""Where experiments are: the workspace a person works in, and those that ship with labrun."""

import itertools
import shutil
import tomllib
from dataclasses import dataclass
from pathlib import Path

from labrun.errors import RequestError
from labrun.toml import suggest

_RESULTS = "results"
_COPIED = (".toml", ".csv", ".xml", ".npz")
"""Experiments and models, the samples of recordings, MJCF models."""


def shipped_experiments() -> Path:
    """Return the folder of the experiments that come with labrun: in the installed package, or the checkout."""
    package = Path(__file__).parents[1]
    installed = package / "shipped_experiments"
    return installed if installed.is_dir() else package.parent / "experiments"


def _folders(workspace: Path) -> tuple[Path, ...]:
    return workspace / "experiments", workspace, shipped_experiments()


def _experiment_files(folder: Path) -> list[Path]:
    """Return the experiment files of a folder: those that say what kind of experiment they are."""
    if not folder.is_dir():
        return []
    return [path for path in sorted(folder.glob("*.toml")) if path.is_file() and _is_experiment(path)]


def _is_experiment(path: Path) -> bool:
    # A look at the text, not a parse: a broken experiment is still to be listed, and found.
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return False
    bare = [line.split("#")[0].replace(" ", "") for line in lines]
    top = itertools.takewhile(lambda line: not line.startswith("["), bare)  # a model's sites have a kind, too
    return any(line.startswith("kind=") for line in top) or any(
        line.startswith(("[rig", "[trial]")) for line in bare
    )


def list_experiments(workspace: Path) -> list[Path]:
    """Return the experiments that can be run from a workspace, one file a name, sorted by name.

    A file in the workspace hides the shipped one of the same name.
    """
    paths: dict[str, Path] = {}
    for folder in _folders(workspace):
        for path in _experiment_files(folder):
            paths.setdefault(path.stem, path)
    return [paths[name] for name in sorted(paths)]


def find_experiment(name_or_path: str, workspace: Path) -> Path:
    """Return the file of an experiment.

    Parameters
    ----------
    name_or_path
        A path, or a name: looked for in the workspace's experiments/, in the workspace itself, then among the shipped.
    workspace
        The folder a person works in.

    Raises
    ------
    RequestError
        There is none; names the nearest.
    """
    given = Path(name_or_path).expanduser()
    if given.suffix == ".toml" or len(given.parts) > 1:
        for path in (given, workspace / given):
            if path.is_file():
                return path
        if len(given.parts) > 1:
            raise RequestError(
                f"cannot find the file or folder {given}",
                hint="labrun list shows the experiments, runs and recordings there are",
            )
    name = given.name.removesuffix(".toml")
    for folder in _folders(workspace):
        path = folder / f"{name}.toml"
        if path.is_file():
            return path
    names = [path.stem for path in list_experiments(workspace)]
    raise RequestError(f'unknown experiment "{name}"', hint=suggest(name, names, kind="experiments"))


def find_model_file(name: str, experiment: Path | None, workspace: Path) -> Path | None:
    """Return the file that ``model = "models/x.toml"`` means, or the name ``x``; None if it names no file that exists.

    Looked for as given, beside the experiment, in the workspace's experiments/, in the workspace, among the shipped. A
    name is not looked for among the shipped: a plugin's model of that name comes before theirs.
    """
    given = Path(name).expanduser()
    folders = [experiment.parent] if experiment is not None else []
    files = [folder / given for folder in (Path(), *folders, *_folders(workspace))]
    if given.parts == (name,) and not given.suffix:
        own = [*folders, *_folders(workspace)[:2]]
        files += [folder / "models" / f"{name}.toml" for folder in own]
    return next((file for file in files if file.is_file()), None)


def create_workspace(directory: Path) -> tuple[list[Path], list[Path]]:
    """Make a workspace with copies of the shipped experiments, their models and recordings.

    Parameters
    ----------
    directory
        Made if it is not there. Nothing in it is overwritten.

    Returns
    -------
    Files that were written, and files that were there already and were left as they are.

    Raises
    ------
    RequestError
        The folder cannot be written.
    """
    source = shipped_experiments()
    written: list[Path] = []
    left: list[Path] = []
    try:
        for path in sorted(path for kind in _COPIED for path in source.rglob(f"*{kind}")):
            target = directory / "experiments" / path.relative_to(source)
            if target.exists():
                left.append(target)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
            written.append(target)
        ignore = directory / ".gitignore"
        if not ignore.exists():
            ignore.write_text(f"/{_RESULTS}/\n", encoding="utf-8")
            written.append(ignore)
    except OSError as error:
        raise RequestError(
            f"workspace {directory} cannot be made: {error.strerror}: {error.filename}"
        ) from error
    return written, left


@dataclass(frozen=True, slots=True)
class ExperimentSummary:
    """One experiment file: what it is, and how many runs of it there are."""

    name: str
    kind: str
    title: str
    path: Path
    runs: int


def summarise_workspace(workspace: Path, results: Path) -> list[ExperimentSummary]:
    """Return the experiments of a workspace and those that ship, sorted by name.

    A file that is not TOML is listed too, with what is wrong as its title.
    """
    summaries = [_summarise(path, results) for path in list_experiments(workspace)]
    return sorted(summaries, key=lambda summary: summary.name)


def _summarise(path: Path, results: Path) -> ExperimentSummary:
    runs = sum(1 for _ in (results / path.stem).glob("*/spec.toml"))
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        return ExperimentSummary(path.stem, "?", f"cannot be read: {error}", path, runs)
    return ExperimentSummary(path.stem, str(data.get("kind", "?")), str(data.get("title", "")), path, runs)
