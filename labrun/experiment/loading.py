"""From a file to an experiment, or to everything that is wrong with it."""

import contextlib
import functools
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labrun import registry
from labrun.errors import RequestError, SpecError
from labrun.experiment.checks import cross_check
from labrun.experiment.experiment import ROBOT_FILES, ROBOT_SCENE, Experiment, written_out
from labrun.experiment.plugins import load_plugin
from labrun.experiment.raw import GAIT_EXPRESSIONS, condition_names, one_or_several, places, table, tables
from labrun.experiment.workspace import find_experiment, find_model_file, shipped_experiments
from labrun.toml import (
    ExpressionError,
    Fault,
    KeyPath,
    Places,
    dotted,
    locate,
    names_in,
    parsed,
    refusal,
    suggest,
    text_of,
    validate,
    written_in_order,
)

_BARE_WORD = re.compile(r"[^\"'\[\]{}=]+")


class OverrideError(SpecError):
    """An override cannot be read, or names a place that is not there."""


def apply_overrides(data: dict[str, Any], overrides: Sequence[str]) -> dict[KeyPath, str]:
    """Set keys of the read file in place.

    Parameters
    ----------
    data
        The file as tomllib gave it.
    overrides
        Texts ``key=value``: the key dotted, a list's entry by its number (``run.conditions.0.release_deg``), the value
        in TOML's syntax; a bare word is text.

    Returns
    -------
    dict
        The paths that were set, and the override each came from.

    Raises
    ------
    OverrideError
        All overrides that cannot be read or placed.
    """
    origins: dict[KeyPath, str] = {}
    wrong: list[str] = []
    for override in overrides:
        try:
            path, value = _read(override)
            path = _put(data, path, value, override)
        except OverrideError as error:
            wrong.append(str(error))
        else:
            origins[path] = f"--set {override}"
    if wrong:
        raise OverrideError("\n".join(wrong))
    return origins


def _read(override: str) -> tuple[KeyPath, Any]:
    key, sign, text = override.partition("=")
    key, text = key.strip(), text.strip()
    if not sign or not key or not text:
        raise OverrideError(
            f"--set {override}: not of the form key=value", hint="example: --set trial.repeats=5"
        )
    path = _path(key, override)
    try:
        return path, tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        if _BARE_WORD.fullmatch(text):
            return path, text
        raise OverrideError(f"--set {override}: {dotted(path)}: the value is not TOML: {error}") from error


def _path(key: str, override: str) -> KeyPath:
    try:
        node: Any = tomllib.loads(f"{key} = 0")
    except tomllib.TOMLDecodeError as error:
        hint = "the parts of a key stand between dots, for example rig.devices.tail.port"
        raise OverrideError(f'--set {override}: "{key}" is not a key', hint=hint) from error
    path: list[str] = []
    while isinstance(node, dict):
        ((part, node),) = node.items()
        path.append(part)
    return tuple(path)


def _put(data: dict[str, Any], path: KeyPath, value: Any, override: str) -> KeyPath:
    current: Any = data
    real: KeyPath = ()
    for number, part in enumerate(path):
        last = number == len(path) - 1
        step: str | int = part
        if isinstance(current, list):
            step = _index(current, str(part), real, override)
        elif not isinstance(current, dict):
            raise OverrideError(
                f"--set {override}: {dotted(real)} is a value, not a table; it has no key {dotted(path[number:])}"
            )
        real = (*real, step)
        if last:
            current[step] = value
        else:
            current = current[step] if isinstance(step, int) else current.setdefault(step, {})
    return real


def _index(items: list[Any], part: str, path: KeyPath, override: str) -> int:
    known = [str(number) for number in range(len(items))]
    if part not in known:
        hint = suggest(part, known, kind="entries")
        raise OverrideError(f"--set {override}: {dotted(path)} is a list and has no entry {part}; {hint}")
    return int(part)


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

    def origin_of(self, key: KeyPath) -> str:
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
        Texts ``key=value``, see `apply_overrides`.

    Raises
    ------
    RequestError
        The file cannot be read.
    SpecError
        All that is wrong with it, each with file, line and column.
    """
    text = text_of(path, what="experiment file")
    return _load(text, path.stem, path, overrides, relative_to=path)


def loads_experiment(
    text: str, name: str, *, plugins: bool = True, relative_to: Path | None = None
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
    relative_to
        Where the text stood as a file, if it names others; what a run stored names none.

    Raises
    ------
    SpecError
        All that is wrong with it.
    """
    return _load(text, name, Path(f"{name}.toml"), (), plugins=plugins, relative_to=relative_to)


def _load(
    text: str,
    name: str,
    path: Path,
    overrides: Sequence[str],
    *,
    relative_to: Path | None = None,
    plugins: bool = True,
) -> LoadedExperiment:
    if relative_to is not None:
        registry.look_beside(relative_to)
    data = parsed(text, str(path), kind=SpecError)
    _expand_short_forms(data, overrides)
    origins = apply_overrides(data, overrides)
    unreadable, nameless = _embed_files(data, relative_to), _names_of_leaders(data, relative_to)
    experiment, faults = validate(Experiment, data)
    # without the table of its kind, or with conditions that cannot be read, no name of a condition is known
    unnamed = any(
        fault.path == ("kind",) or fault.path[1:2] == ("conditions",) for fault in faults
    ) and not condition_names(data)
    faults += [*unreadable, *nameless]
    if plugins and not (nameless or unnamed):  # every use of a condition's name would be a fault
        faults += cross_check(data, relative_to)
    if experiment is None or faults:
        raise refusal(SpecError, str(path), Places(str(path), text, data, origins).of_all(faults))
    return LoadedExperiment(experiment, name, path, resolved(experiment), origins)


def resolved(experiment: Experiment) -> str:
    """Return an experiment as TOML, defaults written out, all keys in their order: that of axes decides the trials'."""
    return written_in_order(experiment.model_dump(mode="python", by_alias=True, exclude_none=True))


def _expand_short_forms(data: dict[str, Any], overrides: Sequence[str]) -> None:
    """Write out ``scene = "name"`` and ``repeats = 3`` where an override reaches inside them."""
    keys = [override.partition("=")[0].strip() for override in overrides]
    rig, trial = data.get("rig"), data.get("trial")
    reaches_scene = any(key.startswith("rig.scene.") for key in keys)
    if reaches_scene and isinstance(rig, dict) and isinstance(rig.get("scene"), str):
        rig["scene"] = written_out(rig["scene"])
    reaches_repeats = any(key.startswith("trial.repeats.") for key in keys)
    if reaches_repeats and isinstance(trial, dict) and type(trial.get("repeats")) is int:
        trial["repeats"] = {"min": trial["repeats"], "max": trial["repeats"]}


def load_named(
    name: str, workspace: Path, overrides: Sequence[str] = (), *, kind: str | None = None
) -> LoadedExperiment:
    """Find an experiment by name or path, and load it.

    Parameters
    ----------
    name
        A name or a path.
    workspace
        The folder a person works in.
    overrides
        ``key=value``, each replacing one key of the file.
    kind
        The kind the command is for; None takes any.

    Raises
    ------
    RequestError
        No such experiment, a file that does not hold, or an experiment of another kind.
    """
    loaded = load_experiment(find_experiment(name, workspace), overrides)
    stored_kind = loaded.experiment.kind
    if kind is not None and stored_kind != kind:
        raise RequestError(
            f'{loaded.name} has kind = "{stored_kind}", not "{kind}"', hint=f"labrun {stored_kind} {name}"
        )
    return loaded


def _embed_files(data: dict[str, Any], experiment: Path | None) -> list[Fault]:
    """Put the content of files that loops name in the place of their names: a stored run needs no other file.

    Returns what is wrong with them. Without the place of the `experiment`, beside which they are looked for, it is one
    that a run stored, and names no file any more.
    """
    faults: list[Fault] = []
    scene = table(data, "rig").get("scene")
    if isinstance(scene, str) and scene.lower().endswith(ROBOT_FILES):
        data["rig"]["scene"] = written_out(scene)
    for group, holder, key, path in _that_name_files(data) if experiment is not None else ():
        keys = holder[key] if isinstance(holder[key], dict) else {}
        embed = getattr(load_plugin(group, keys.get("plugin"), ())[0], "embed", None)
        if embed is None or experiment is None:
            continue
        try:
            holder[key] = embed(keys, functools.partial(_find_file, experiment))
        except SpecError as error:
            texts = [key for key, value in keys.items() if isinstance(value, str) and value in str(error)]
            faults.append(Fault((*path, *texts[:1]), str(error).replace("\n  ", "; "), at_value=bool(texts)))
    return faults


def _names_of_leaders(data: dict[str, Any], experiment: Path | None) -> list[Fault]:
    """Say what the conditions will be called that are leaders of other runs; return what is wrong with their names."""
    if experiment is None:
        return []
    conditions, sibling = table(data, "run").get("conditions"), table(data, "leaders").get("beside")
    faults = []
    if isinstance(conditions, dict):
        path: KeyPath = ("run", "conditions", "leaders_of")
        faults += _name_leaders(conditions, path, experiment)
        theirs = set(conditions.get("names", ())) - {"gait"}
        used = _used_by_gait(data) - set(table(data, "run", "over")) - {"gait"}
        if theirs and used and not theirs & used:
            listed = f"{', '.join(sorted(theirs))}; the gait here uses {', '.join(sorted(used))}"
            faults.append(
                Fault(
                    path, f"the leaders' conditions have the names {listed}; name them alike", at_value=True
                )
            )
    if isinstance(sibling, dict):
        path = ("leaders", "beside", "leaders_of")
        faults += _name_leaders(sibling, path, experiment)
        shared = [*table(data, str(data.get("kind")), "over"), *table(data, str(data.get("kind")), "each")]
        own = {name for name in condition_names(data) if name not in shared}
        theirs = set(sibling.get("names", ())) - {"gait"}
        if theirs and theirs != own - {"gait"}:
            listed = f"{', '.join(sorted(theirs))}; those here {', '.join(sorted(own))}"
            faults.append(
                Fault(
                    path, f"the leaders' conditions have the names {listed}; name them alike", at_value=True
                )
            )
    return faults


def _used_by_gait(data: Mapping[str, Any]) -> set[str]:
    """Return the names in the expressions of the gait's joints that can be read."""
    used: set[str] = set()
    for _, expression in places(data, GAIT_EXPRESSIONS):
        with contextlib.suppress(ExpressionError):
            used |= names_in(expression) if isinstance(expression, str) else set()
    return used


def _name_leaders(wanted: dict[str, Any], path: KeyPath, experiment: Path) -> list[Fault]:
    given = wanted.get("leaders_of")
    names_of: dict[str, list[str]] = {}
    for name in [given] if isinstance(given, str) else given if isinstance(given, list) else []:
        if not isinstance(name, str):
            continue
        try:
            file = find_beside(name, experiment)
        except RequestError as error:
            return [Fault(path, str(error), at_value=True)]
        theirs = parsed(text_of(file, what="experiment file"), str(file), kind=SpecError)
        over = table(theirs, str(theirs.get("kind")), "over")
        names_of[name] = [name for name in condition_names(theirs) if name not in over]
    if len({tuple(sorted(names)) for names in names_of.values()}) > 1:
        listed = "; ".join(f"{name}: {', '.join(names)}" for name, names in names_of.items())
        return [
            Fault(
                path,
                f"the conditions of these experiments have different names ({listed}); name those with the same ones",
                at_value=True,
            )
        ]
    if names_of:
        wanted["names"] = ["gait", *next(iter(names_of.values()))]
    return []


def find_beside(name: str, experiment: Path) -> Path:
    """Return the experiment with a name: in the same folder, or shipped.

    Raises
    ------
    RequestError
        There is none.
    """
    sibling = experiment.parent / f"{name}.toml"
    return sibling if sibling.is_file() else find_experiment(name, experiment.parent.parent)


def _that_name_files(data: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any, KeyPath]]:
    """Yield a robot's scene and each plugin of a loop: group, the table that holds it, its key there, its path."""
    if table(data, "rig", "scene").get("plugin") == ROBOT_SCENE:
        yield "labrun.scenes", table(data, "rig"), "scene", ("rig", "scene")
    for name, loop in tables(data, "track", "loops").items():
        path: KeyPath = ("track", "loops", name)
        for key in ("reference", "feedback"):
            for inner, _ in one_or_several(loop, key):
                yield f"labrun.{key}s", loop[key] if inner[1:] else loop, inner[-1], (*path, *inner)
        controllers = table(loop, "controllers")
        for controller in list(controllers):
            yield "labrun.controllers", controllers, controller, (*path, "controllers", controller)


def _find_file(experiment: Path, name: str) -> Path:
    file = find_model_file(name, experiment, Path())
    if file is None:
        siblings = sorted((experiment.parent / name).parent.glob(f"*{Path(name).suffix}"))
        known = [str(Path(name).parent / item.name) for item in siblings if item != experiment]
        kind = f"{Path(name).suffix} files".strip()
        raise SpecError(f'cannot find the file "{name}"; {suggest(name, known, kind=kind)}')
    shipped = shipped_experiments().resolve()
    if file.resolve().is_relative_to(shipped) and not experiment.resolve().is_relative_to(shipped):
        raise SpecError(
            f'cannot find the file "{name}" in this workspace; labrun ships one of that name, of its own bench',
            hint=f"make yours, or copy that one with what stands beside it: {file}",
        )
    return file
