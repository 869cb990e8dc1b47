"""From a device's table in the file to the class that drives it, or stands in for it, and to the ports it needs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from labrun.devices import DeviceSettings
from labrun.errors import PluginError, RequestError, SpecError
from labrun.registry import is_installed, load
from labrun.toml import PluginTable, nearest

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


def resolve_device(name: str, table: PluginTable, *, dry_run: bool) -> ResolvedDevice:
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


_SERIAL = ("/dev/", "COM", "\\\\.\\COM")


def port_of(settings: BaseModel) -> str | None:
    """Return the serial port a device's settings name; None for a network address or no port at all."""
    return next(iter(_serial_ports(settings)), None)


def ports_of(settings: BaseModel) -> list[str]:
    """Return what only one run at a time may use: every port of a device's settings, serial or not, and its host."""
    found: list[str] = []
    for name, field in type(settings).model_fields.items():
        if name in ("port", "host") or "port" in field.metadata or _holds_port(field.annotation):
            value = getattr(settings, name)
            found += [value] if isinstance(value, str) else value if isinstance(value, list | tuple) else []
    return [port for port in found if isinstance(port, str) and port]


def _holds_port(annotation: Any) -> bool:
    """Tell whether a type is `Port`, or made of it: ``Port | None``, ``tuple[Port, ...]``."""
    marks = getattr(annotation, "__metadata__", ())
    return "port" in marks or any(_holds_port(part) for part in get_args(annotation))


def _serial_ports(settings: BaseModel) -> list[str]:
    return [port for port in ports_of(settings) if port.startswith(_SERIAL)]


def existing_ports() -> list[str]:
    """Return the serial ports of this machine."""
    from serial.tools import list_ports

    return sorted(port.device for port in list_ports.comports())


def missing_ports(settings: Mapping[str, BaseModel]) -> list[str]:
    """Return one sentence for every serial port of a device that does not exist."""
    problems = []
    for device, table in settings.items():
        for port in _serial_ports(table):
            if Path(port).exists():
                continue
            there = existing_ports()
            near = nearest(port, there, cutoff=0.8)
            known = (
                f"ports of this machine: {', '.join(there)}" if there else "this machine has no serial port"
            )
            beside = f"; {near} is there" if near else ""
            problems.append(f"device {device}: port {port} does not exist{beside} ({known})")
    return problems
