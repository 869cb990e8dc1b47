"""Plugins by name: entry points of labrun's groups, what rigs declare, or "package.module:Class".

A rig is a folder with a ``rig.toml``, in a package that an entry point of group ``labrun.rigs`` names. Its tables are
groups, its values ``"module:Object"`` inside of the folder::

    [scenes]
    my-tank = "scene:MyTank"
"""

import importlib
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoint, EntryPoints, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from labrun.errors import PluginError
from labrun.toml import nearest

GROUPS = (
    "labrun.devices",
    "labrun.emulators",
    "labrun.gaits",
    "labrun.objectives",
    "labrun.controllers",
    "labrun.references",
    "labrun.feedbacks",
    "labrun.inverses",
    "labrun.fits",
    "labrun.models",
    "labrun.effects",
    "labrun.scenes",
    "labrun.cases",
)
RIGS = "labrun.rigs"
RIG_FILE = "rig.toml"


_folders: dict[Path, None] = {}
"""Where experiment files stood: plugins may stand beside them."""


def look_beside(file: Path) -> None:
    """Let "package.module:Class" also name modules in the folder of an experiment file."""
    _folders[file.resolve().parent] = None


@dataclass(frozen=True, slots=True)
class PluginEntry:
    """One installed plugin, the distribution and version that brings it, and why it fails if that is known."""

    group: str
    name: str
    target: str
    origin: str
    cause: str = ""


@lru_cache(maxsize=1)
def _entry_points() -> dict[str, EntryPoints]:
    """Return the entry points by group; the files of all distributions are read once a process."""
    every = entry_points()
    return {group: every.select(group=group) for group in (*GROUPS, RIGS)}


@lru_cache(maxsize=len(GROUPS))
def _entries(group: str) -> dict[str, tuple[EntryPoint, Distribution | None]]:
    """Return entry points by name, each with the distribution that brings it."""
    entries = {entry.name: (entry, entry.dist) for entry in _entry_points()[group]}
    return entries | {entry.name: (entry, dist) for entry, dist in _of_rigs() if entry.group == group}


@lru_cache(maxsize=1)
def _of_rigs() -> list[tuple[EntryPoint, Distribution | None]]:
    """Return what the folders of all rigs declare; imports none of them."""
    rigs = []
    for package in _entry_points()[RIGS]:
        try:
            spec = find_spec(package.value)
        except ModuleNotFoundError as error:
            raise PluginError(f"the rigs of {_origin(package.dist)} cannot be found: {error}") from error
        for location in (spec.submodule_search_locations or ()) if spec is not None else ():
            for path in sorted(Path(location).glob(f"*/{RIG_FILE}")):
                rig = f"{package.value}.{path.parent.name}"
                rigs += [(entry, package.dist) for entry in _declared(path, rig)]
    return rigs


def _declared(path: Path, rig: str) -> Iterator[EntryPoint]:
    """Yield the entry points in a rig's file, whose modules are those of the package `rig`."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise PluginError(f"{path} cannot be read: {error}") from error
    kinds = [group.removeprefix("labrun.") for group in GROUPS]
    for kind, plugins in content.items():
        if kind not in kinds or not isinstance(plugins, dict):
            near = nearest(kind, kinds)
            raise PluginError(
                f"{path}: a rig declares no {kind!r}",
                hint=f"did you mean [{near}]?" if near else f"it declares tables {', '.join(kinds)}",
            )
        for name, target in plugins.items():
            yield EntryPoint(name, f"{rig}.{target}", f"labrun.{kind}")


def read_again() -> None:
    """Forget which plugins are installed; needed after a folder with distributions was added to `sys.path`."""
    for cached in (_entry_points, _entries, _of_rigs):
        cached.cache_clear()


@lru_cache
def _origin(dist: Distribution | None) -> str:
    """Return name and version, which stand in a file that is slow to parse."""
    return f"{dist.name} {dist.version}" if dist is not None else "unknown"


def installed(group: str) -> list[PluginEntry]:
    """Return the plugins of a group, sorted by name; imports none of them."""
    return [
        PluginEntry(group, name, entry.value, _origin(dist))
        for name, (entry, dist) in sorted(_entries(group).items())
    ]


def names(group: str) -> list[str]:
    """Return the names of a group's plugins."""
    return sorted(_entries(group))


def is_installed(group: str, name: str) -> bool:
    """Tell whether an entry point of that name exists."""
    return name in _entries(group)


def _kind(group: str) -> str:
    """Return the word for a plugin of a group in messages."""
    return group.removeprefix("labrun.").removesuffix("s")


def _entry(group: str, name: str) -> tuple[EntryPoint, Distribution | None]:
    """Return an entry point with its distribution. Raises PluginError: unknown name."""
    if name not in _entries(group):
        near = nearest(name, names(group))
        known = ", ".join(names(group)) or "none"
        hint = f"did you mean {near!r}?" if near else f"installed: {known}"
        raise PluginError(f"unknown {_kind(group)} plugin {name!r}", hint=hint)
    return _entries(group)[name]


def load(group: str, name: str) -> Any:
    """Return the object a plugin names.

    Parameters
    ----------
    group
        One of `GROUPS`.
    name
        An entry point's name, or a dotted name ``"package.module:Object"``.

    Raises
    ------
    PluginError
        Unknown name (with the nearest one), or a failing import (with its cause).
    """
    kind = _kind(group)
    if ":" in name:
        return _load_dotted(kind, name)
    entry, dist = _entry(group, name)
    try:
        return entry.load()
    except Exception as error:  # whatever a third party's module raises while it is imported
        brought_by = entry.value if dist is None else dist.name
        raise PluginError(
            f"{kind} plugin {name!r} of {brought_by} cannot be imported: {type(error).__name__}: {error}",
            hint=f"python -c 'import {entry.module}' shows the whole cause",
        ) from error


def package_folder(group: str, name: str) -> Path:
    """Return the folder of the package that an entry point names; does not import the package.

    Raises
    ------
    PluginError
        Unknown name, or a package that does not exist.
    """
    entry, dist = _entry(group, name)
    spec = find_spec(entry.module)
    if spec is None or spec.origin is None:
        raise PluginError(
            f"the package {entry.value!r} of {_origin(dist)}, entry point {name!r} of {group}, does not exist",
            hint="install the distribution again",
        )
    return Path(spec.origin).parent


def _load_dotted(kind: str, name: str) -> Any:
    module_name, _, attribute = name.partition(":")
    before = sys.path
    # Behind everything else, so that no file beside an experiment hides an installed module. A run that is resumed
    # knows no folder: it is looked for in the workspace, where experiments are.
    sys.path = [*before, *map(str, (*_folders, Path("experiments").resolve(), Path.cwd()))]
    try:
        target = importlib.import_module(module_name)
        for part in attribute.split("."):
            target = getattr(target, part)
    except Exception as error:
        raise PluginError(
            f"{kind} plugin {name!r} cannot be imported: {type(error).__name__}: {error}",
            hint='a dotted name is "package.module:Class", of a module beside the experiment file or installed',
        ) from error
    finally:
        sys.path = before
    return target


def inspect_all() -> list[PluginEntry]:
    """Import every installed plugin of every group, and say which of them fail and why."""
    inspected = []
    for entry in (entry for group in GROUPS for entry in installed(group)):
        try:
            load(entry.group, entry.name)
        except PluginError as error:
            entry = replace(entry, cause=str(error.args[0]))  # noqa: PLW2901
        inspected.append(entry)
    return inspected
