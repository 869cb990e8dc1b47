"""What the devices of a file are, as far as that can be known without connecting any."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from labrun import registry
from labrun.devices import DeviceContext, Limits
from labrun.errors import PluginError
from labrun.toml import Fault, KeyPath, mend, suggest, validate

GROUP = "labrun.devices"
STAND_IN = "simulated-"


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """One device of the file.

    Attributes
    ----------
    joints
        What it drives; empty for what is no actuator.
    channels
        What it measures; None if that cannot be known.
    carriage
        Whether it can travel; None if that cannot be known.
    """

    joints: tuple[str, ...]
    channels: tuple[str, ...] | None
    carriage: bool | None


class _NoClock:
    """For a device that is made only to be asked what it is."""

    poll_s = 0.01

    def now(self) -> float:
        return 0.0

    def sleep(self, duration_s: float) -> None:
        raise RuntimeError(f"a device waits {duration_s} s before it is opened")


def examine(name: str, table: Mapping[str, Any]) -> tuple[DeviceInfo, list[Fault]]:
    """Return what a device is, and what is wrong with its table."""
    base: KeyPath = ("rig", "devices", name)
    plugin = table.get("plugin")
    settings = {key: value for key, value in table.items() if key != "plugin"}
    if not isinstance(plugin, str):
        return _guess(name, settings, None), _limits_alone(settings, base)
    plugin_class, problem = find_class(plugin, (*base, "plugin"))
    if problem is not None:
        return _guess(name, settings, None), [problem, *_limits_alone(settings, base)]
    model = getattr(plugin_class, "Settings", None)
    if model is None:
        return _guess(name, settings, plugin_class), []
    checked, problems = mend(model, settings, base, also=["plugin"])
    if checked is None:
        return _guess(name, settings, plugin_class), problems
    return _ask(name, settings, plugin_class, checked), problems


def find_class(plugin: str, path: KeyPath) -> tuple[Any, Fault | None]:
    """Return the class that knows all keys of a device: its stand-in's where there is one, else the driver's own.

    A stand-in takes the driver's keys and some of its own, such as faults on request; whether the driver takes those of
    the file is checked when it is made.
    """
    stand_in = STAND_IN + plugin
    if not registry.is_installed(GROUP, stand_in):
        if ":" in plugin or registry.is_installed(GROUP, plugin):
            try:
                return registry.load(GROUP, plugin), None
            except PluginError as error:
                return None, Fault(path, _one_line(error), at_value=True)
        known = sorted({known.removeprefix(STAND_IN) for known in registry.names(GROUP)})
        return None, Fault(
            path, f"unknown device plugin; {suggest(plugin, known, kind='installed')}", at_value=True
        )
    try:
        return registry.load(GROUP, stand_in), None
    except PluginError as error:
        return None, Fault(path, _one_line(error), at_value=True)


def _one_line(error: PluginError) -> str:
    return str(error).replace("\n  ", "; ")


def _limits_alone(settings: Mapping[str, Any], base: KeyPath) -> list[Fault]:
    limits = settings.get("limits")
    return validate(Limits, limits, (*base, "limits"))[1] if isinstance(limits, Mapping) else []


def _ask(name: str, settings: Mapping[str, Any], plugin_class: Any, checked: Any) -> DeviceInfo:
    """Make the device, which connects nothing, and look at it."""
    import numpy as np

    try:
        device = plugin_class(name, checked, DeviceContext(clock=_NoClock(), rng=np.random.default_rng(0)))
    except (
        Exception
    ):  # a plugin may need its scene or more; then what it is stays a guess, and the runner will know
        return _guess(name, settings, plugin_class)
    channels = getattr(device, "channels", ())
    return DeviceInfo(
        joints=tuple(device.joints) if hasattr(device, "follow") else (),
        channels=tuple(channel.name for channel in channels),
        carriage=hasattr(device, "travel"),
    )


def _guess(name: str, settings: Mapping[str, Any], plugin_class: Any) -> DeviceInfo:
    actuator = plugin_class is None or hasattr(plugin_class, "follow")
    joints = settings.get("joints")
    named: Sequence[str] = (
        [str(joint) for joint in joints] if isinstance(joints, dict | list) and joints else [name]
    )
    channels = getattr(plugin_class, "channels", None)
    return DeviceInfo(
        joints=tuple(named) if actuator else (),
        channels=tuple(channel.name for channel in channels) if isinstance(channels, tuple) else None,
        carriage=None if plugin_class is None else hasattr(plugin_class, "travel"),
    )
