"""From a device's table in the file to the class that drives it, or that stands in for it in a dry run."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from labrun.devices import DeviceSettings
from labrun.errors import PluginError, RequestError, SpecError
from labrun.registry import is_installed, load
from labrun.toml import PluginTable

_GROUP = "labrun.devices"
STAND_IN = "simulated-"
"""Begins the name of a stand-in; the rest is the plugin it stands in for."""


@dataclass(frozen=True, slots=True)
class ResolvedDevice:
    """A device's class and its checked settings."""

    name: str
    plugin: str
    make: Any
    settings: DeviceSettings


def _is_driver(plugin: str) -> bool:
    return ":" in plugin or is_installed(_GROUP, plugin)


def stand_in_name(plugin: str) -> str:
    """Return the plugin that takes a plugin's place in a dry run.

    A driver whose stand-in is called after it is not imported: a dry run needs nothing of it.
    """
    if plugin.startswith(STAND_IN):
        return plugin
    if is_installed(_GROUP, STAND_IN + plugin):
        return STAND_IN + plugin
    if _is_driver(plugin):
        declared = getattr(load(_GROUP, plugin), "stand_in", None)
        if isinstance(declared, str):
            return declared
    # A dotted driver that names no stand-in is its own: it is told about the scene, and may use it.
    return plugin if ":" in plugin else STAND_IN + plugin


def resolve(name: str, table: PluginTable, *, dry_run: bool) -> ResolvedDevice:
    """Find a device's class and check its settings.

    Raises
    ------
    RequestError
        There is no driver for this hardware here.
    PluginError
        Unknown plugin, or one that does not import.
    SpecError
        Its settings do not hold.
    """
    plugin = stand_in_name(table.plugin) if dry_run else table.plugin
    if not dry_run and not _is_driver(plugin) and is_installed(_GROUP, STAND_IN + plugin):
        port = table.settings.get("port")
        where = f" at {port}" if port else ""
        raise RequestError(
            f"device {name}{where}: no driver {plugin!r} is installed here, only its stand-in {STAND_IN + plugin!r}",
            hint="--dry-run works without it; install the driver's package to run the bench",
        )
    if dry_run and not _is_driver(plugin) and plugin != table.plugin:
        load(_GROUP, table.plugin)  # an unknown plugin is named as the person wrote it
        raise PluginError(
            f"device {name}: {table.plugin!r} has no stand-in {plugin!r}, so a dry run cannot simulate it",
            hint="a driver names its stand-in in the class attribute stand_in",
        )
    make = load(_GROUP, plugin)
    return ResolvedDevice(name, plugin, make, check_settings(name, make, table.settings))


def check_settings(name: str, make: Any, settings: Mapping[str, Any]) -> DeviceSettings:
    """Return a device's settings as its plugin understands them; SpecError names every key that does not hold."""
    model: type[DeviceSettings] = getattr(make, "Settings", DeviceSettings)
    try:
        return model.model_validate(dict(settings))
    except ValidationError as error:
        problems = []
        for item in error.errors():
            key = ".".join(str(part) for part in ("rig.devices", name, *item["loc"]))
            problems.append(f"{key}: {item['msg']} (found {item['input']!r})")
        raise SpecError(
            "\n".join(problems), hint=f"keys it knows: {', '.join(sorted(model.model_fields))}"
        ) from error
