"""From a file to an experiment, or to everything that is wrong with it."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from labrun.errors import RequestError
from labrun.nearest import nearest
from labrun.spec.checks import cross_check
from labrun.spec.embedding import embed_files
from labrun.spec.experiment import Experiment
from labrun.spec.overrides import apply_overrides
from labrun.spec.problem import LocatedProblem, Problem, SpecFileError, dotted
from labrun.spec.validation import validate
from labrun.toml_positions import KeyPath, Positions, locate


@dataclass(frozen=True, slots=True)
class LoadedExperiment:
    """An experiment, where it came from, and its full text.

    Attributes
    ----------
    experiment
        What the file says, overrides and defaults included.
    name
        The file's stem; runs are filed under it.
    path
        The file. Of a stored experiment, its name alone.
    resolved_toml
        The experiment with overrides and defaults written out; loading it gives an equal experiment.
    origins
        The keys that overrides have set, and the override each came from.
    """

    experiment: Experiment
    name: str
    path: Path
    resolved_toml: str
    origins: Mapping[KeyPath, str] = field(default_factory=dict, compare=False)

    def place(self, key: KeyPath) -> str:
        """Return where the value of a key comes from: "file:line:column", or the override that brought it."""
        for path, override in self.origins.items():
            if key[: len(path)] == path:
                return override
        try:
            position = locate(self.path.read_text(encoding="utf-8")).of_value(key)
        except (OSError, UnicodeDecodeError):  # the file of a stored experiment is its name alone
            return str(self.path)
        return f"{self.path}:{position.line}:{position.column}"


def load_experiment(path: Path, overrides: Sequence[str] = ()) -> LoadedExperiment:
    """Read an experiment file.

    Parameters
    ----------
    path
        The file.
    overrides
        Texts ``key=value``, see `labrun.spec.overrides.apply_overrides`.

    Raises
    ------
    RequestError
        The file cannot be read.
    SpecFileError
        All that is wrong with it, each with file, line and column.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RequestError(f"experiment file {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RequestError(f"experiment file {path} is not text in UTF-8 (byte {error.start})") from error
    return _load(text, path.stem, path, overrides, beside=path)


def loads_experiment(
    text: str, name: str, *, plugins: bool = True, beside: Path | None = None
) -> LoadedExperiment:
    """Read an experiment from its text, for example from the spec stored with a run.

    Parameters
    ----------
    text
        The file's content.
    name
        What the experiment is filed under.
    plugins
        False to read what a run stored: how its tables fit together, and to the plugins, was checked when the run
        began. The plugins need not be installed to look at what they measured.
    beside
        Where the text stood as a file, if it names others; what a run stored names none.

    Raises
    ------
    SpecFileError
        All that is wrong with it.
    """
    return _load(text, name, Path(f"{name}.toml"), (), plugins=plugins, beside=beside)


def _load(
    text: str,
    name: str,
    path: Path,
    overrides: Sequence[str],
    *,
    beside: Path | None = None,
    plugins: bool = True,
) -> LoadedExperiment:
    data = _parse(text, path)
    _expand_short_forms(data, overrides)
    origins = apply_overrides(data, overrides)
    unreadable = embed_files(data, beside)
    experiment, problems = validate(Experiment, data)
    problems += unreadable
    if plugins:
        problems += cross_check(data, beside)
    if experiment is None or problems:
        where = _Places(path, locate(text), origins, data)
        raise SpecFileError(str(path), where.of_all(problems))
    return LoadedExperiment(
        cast("Experiment", experiment), name, path, resolved(cast("Experiment", experiment)), origins
    )


def resolved(experiment: Experiment) -> str:
    """Return an experiment as TOML, defaults written out."""
    import tomli_w

    tree = experiment.model_dump(mode="python", by_alias=True, exclude_none=True)
    return tomli_w.dumps(tree)


def _parse(text: str, path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise SpecFileError(
            str(path), [LocatedProblem(str(path), None, None, "", None, "nested too deeply")]
        ) from error
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        place = re.search(r" \(at line (\d+), column (\d+)\)$", message)
        if place is not None:
            line, column = int(place[1]), int(place[2])
            message = message[: place.start()]
        else:  # at the end of the text
            line, column = text.count("\n") + 1, len(text.rpartition("\n")[2]) + 1
            message = re.sub(r" \(at end of document\)$", " at the end of the file", message)
        origin = f"{path}:{line}:{column}"
        found = LocatedProblem(origin, line, column, "", None, f"not valid TOML: {message}")
        raise SpecFileError(str(path), [found]) from error


def _expand_short_forms(data: dict[str, Any], overrides: Sequence[str]) -> None:
    """Write out ``scene = "name"`` and ``repeats = 3`` where an override reaches inside them."""
    keys = [override.partition("=")[0].strip() for override in overrides]
    rig, trial = data.get("rig"), data.get("trial")
    reaches_scene = any(key.startswith("rig.scene.") for key in keys)
    if reaches_scene and isinstance(rig, dict) and isinstance(rig.get("scene"), str):
        rig["scene"] = {"plugin": rig["scene"]}
    reaches_repeats = any(key.startswith("trial.repeats.") for key in keys)
    if reaches_repeats and isinstance(trial, dict) and type(trial.get("repeats")) is int:
        trial["repeats"] = {"min": trial["repeats"], "max": trial["repeats"]}


_ABSENT = object()


class _Places:
    """Finds the place of each problem: a line of the file, or the override that brought the key."""

    def __init__(
        self, path: Path, positions: Positions, origins: Mapping[KeyPath, str], data: Mapping[str, Any]
    ) -> None:
        self._path = path
        self._positions = positions
        self._origins = origins
        self._data = data

    def of_all(self, problems: Sequence[Problem]) -> list[LocatedProblem]:
        found = list(dict.fromkeys((problem.path, problem.message, problem.at_value) for problem in problems))
        located = [self._of(Problem(*item)) for item in found]
        return sorted(located, key=lambda item: (item.line is not None, item.line or 0, item.column or 0))

    def _of(self, problem: Problem) -> LocatedProblem:
        value = self._value(problem.path)
        message = problem.message
        shown = None if value is _ABSENT or isinstance(value, dict) else value
        for path, override in self._origins.items():
            if path[: len(problem.path)] == problem.path or problem.path[: len(path)] == path:
                in_file = problem.path in self._positions.keys and len(problem.path) < len(path)
                if not in_file:
                    if "did you mean" not in message:
                        message += self._misspelt_table(problem.path)
                    return LocatedProblem(override, None, None, dotted(problem.path), shown, message)
        place = self._positions.of_value if problem.at_value else self._positions.of_key
        position = place(problem.path)
        origin = f"{self._path}:{position.line}:{position.column}"
        return LocatedProblem(origin, position.line, position.column, dotted(problem.path), shown, message)

    def _misspelt_table(self, path: KeyPath) -> str:
        """Return a suggestion where an override made a table because the name of the one it meant was misspelt."""
        value, parent = self._value(path), self._value(path[:-1])
        if not isinstance(value, dict) or not isinstance(parent, dict) or not path:
            return ""
        near = nearest(str(path[-1]), [key for key in parent if key != path[-1]])
        return f'; did you mean "{dotted((*path[:-1], near))}"?' if near is not None else ""

    def _value(self, path: KeyPath) -> Any:
        value: Any = self._data
        for part in path:
            try:
                value = value[part]
            except (KeyError, IndexError, TypeError):
                return _ABSENT
        return value
