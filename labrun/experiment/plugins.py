"""Check the plugins that a file names, and their keys."""

import math
from collections.abc import Iterator, Mapping
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel

from labrun import registry
from labrun.devices import DeviceContext, Limits
from labrun.errors import PluginError
from labrun.experiment.experiment import ROBOT_FILES, STILL, GaitTable, ObjectiveTable, RigTable, SceneTable
from labrun.experiment.loop_tables import LOOP_DEVICE, TIMING_CHANNELS, shape_of
from labrun.experiment.raw import DeviceInfo, check_channel, drives_of, one_or_several, table, tables
from labrun.experiment.search_tables import SIMULATION
from labrun.toml import Fault, KeyPath, Operand, evaluate, mend, suggest, validate

_DEVICES = "labrun.devices"
_STAND_IN = "simulated-"
PLAIN_SCENE = "plain"
"""The scene of an experiment that names none."""


def load_plugin(group: str, plugin: object, path: KeyPath) -> tuple[Any, list[Fault]]:
    """Return a plugin's class or the reason why it cannot be loaded; both empty if none is named.

    Of a device it is the stand-in's class where there is one: that knows the driver's keys and some of its own, such as
    faults on request. Whether the driver takes those of the file is checked when it is made.
    """
    if not isinstance(plugin, str):
        return None, []
    stand_in = _STAND_IN + plugin
    named = stand_in if group == _DEVICES and registry.is_installed(group, stand_in) else plugin
    if ":" not in named and not registry.is_installed(group, named):
        kind = group.removeprefix("labrun.").removesuffix("s")
        known = sorted({name.removeprefix(_STAND_IN) for name in registry.names(group)})
        hint = suggest(plugin, known, kind="installed")
        if group == "labrun.scenes" and "." in plugin:
            hint = f"a robot's file ends in {', '.join(ROBOT_FILES)}, and a class of yours is module:Class"
        return None, [Fault(path, f"unknown {kind} plugin; {hint}", at_value=True)]
    try:
        return registry.load(group, named), []
    except PluginError as error:
        return None, [Fault(path, str(error).replace("\n  ", "; "), at_value=True)]


def check_settings(plugin: Any, keys: Mapping[str, Any], path: KeyPath, own: list[str]) -> Iterator[Fault]:
    """Yield faults of a plugin's keys, except those of `own`."""
    model = getattr(plugin, "Settings", None)
    if isinstance(model, type) and issubclass(model, BaseModel):
        settings = {key: value for key, value in keys.items() if key not in own}
        yield from validate(model, settings, path, also=own)[1]


def is_expression(model: type[BaseModel], key: str, value: object) -> bool:
    """Tell whether a setting is an expression: text where the plugin takes a number and no text."""
    field = model.model_fields.get(key)
    if field is None or not isinstance(value, str):
        return False
    kinds = set(_kinds(field.annotation))
    return bool(kinds & {int, float}) and str not in kinds


def resolved_settings(
    model: type[BaseModel] | None, settings: Mapping[str, Any], names: Mapping[str, Operand]
) -> dict[str, Any]:
    """Return settings with every expression, such as a gain that is swept, computed from the values of a condition.

    Raises
    ------
    ExpressionError
        An expression cannot be read or computed.
    """
    if model is None:
        return dict(settings)
    return {
        key: evaluate(value, names) if is_expression(model, key, value) else value
        for key, value in settings.items()
    }


def _kinds(annotation: Any) -> Iterator[type]:
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _kinds(get_args(annotation)[0])
    elif origin in (Union, UnionType):
        for member in get_args(annotation):
            yield from _kinds(member)
    elif isinstance(annotation, type):
        yield annotation


def examine(name: str, keys: Mapping[str, Any]) -> tuple[DeviceInfo, list[Fault]]:
    """Return the description of a device, and the faults of its table."""
    base: KeyPath = ("rig", "devices", name)
    settings = {key: value for key, value in keys.items() if key != "plugin"}
    plugin, faults = load_plugin(_DEVICES, keys.get("plugin"), (*base, "plugin"))
    if plugin is None:
        limits = settings.get("limits")
        if isinstance(limits, Mapping):
            faults += validate(Limits, limits, (*base, "limits"))[1]
        return _guess(name, settings, None), faults
    model = getattr(plugin, "Settings", None)
    if model is None:
        return _guess(name, settings, plugin), []
    checked, faults = mend(model, settings, base, also=["plugin"])
    return _ask(name, plugin, checked) or _guess(name, settings, plugin), faults


def scene_of(rig: RigTable) -> SceneTable:
    """Return what stands in for a bench in a dry run: the scene it names, or the plain one, made of its devices.

    In the plain one joints follow their commands within their limits, and sensors read zero and their own noise.
    """
    if rig.scene is not None:
        return rig.scene
    joints: dict[str, tuple[float, float]] = {}
    feels: list[str] = []
    for name, written in rig.devices.items():
        info, _ = examine(name, {"plugin": written.plugin, **written.settings})
        angle_deg = table(written.settings, "limits").get("angle_deg", (-math.inf, math.inf))
        joints |= dict.fromkeys(info.joints, tuple(angle_deg))
        feels += info.feels
    return SceneTable.model_validate({"plugin": PLAIN_SCENE, "joints_deg": joints, "feels": feels})


class _NoClock:
    """A clock for devices that are created only for inspection."""

    poll_s = 0.01

    def now(self) -> float:
        return 0.0

    def sleep(self, duration_s: float) -> None:
        raise RuntimeError(f"a device waits {duration_s} s before it is opened")


def _ask(name: str, plugin: Any, settings: BaseModel | None) -> DeviceInfo | None:
    """Make the device, which connects nothing, and look at it; None if it cannot be made."""
    if settings is None:
        return None
    try:
        device = plugin(name, settings, DeviceContext(clock=_NoClock(), rng=np.random.default_rng(0)))
    # it may need its scene or more; then what it is stays a guess, and the runner will know
    except Exception:
        return None
    return DeviceInfo(
        joints=tuple(device.joints) if hasattr(device, "follow") else (),
        channels=tuple(channel.name for channel in getattr(device, "channels", ())),
        carriage=hasattr(device, "travel"),
        feels=tuple(getattr(device, "feels", ())),
    )


def _guess(name: str, settings: Mapping[str, Any], plugin: Any) -> DeviceInfo:
    joints = settings.get("joints")
    named = [str(joint) for joint in joints] if isinstance(joints, dict | list) and joints else [name]
    channels = getattr(plugin, "channels", None)
    return DeviceInfo(
        joints=tuple(named) if plugin is None or hasattr(plugin, "follow") else (),
        channels=tuple(channel.name for channel in channels) if isinstance(channels, tuple) else None,
        carriage=None if plugin is None else hasattr(plugin, "travel"),
    )


def check_plugins(data: Mapping[str, Any], devices: Mapping[str, DeviceInfo]) -> Iterator[Fault]:
    """Yield faults of scene, gait and objectives that do not depend on other tables."""
    yield from _check_scene(data)
    yield from _check_gait(data)
    loops = tables(data, "track", "loops")
    if data.get("kind") == "track" and loops:  # an objective may look at the loops as if they were a device
        channels = _loop_channels(loops)
        devices = {**devices, LOOP_DEVICE: DeviceInfo(joints=(), channels=channels, carriage=False)}
    if data.get("kind") == "design":  # what there is to look at, the model says
        devices = {SIMULATION: DeviceInfo(joints=(), channels=None, carriage=False)}
    for name, objective in tables(data, "objectives").items():
        yield from _check_objective(objective, ("objectives", name), devices)


def _loop_channels(loops: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    channels: list[str] = []
    for name, loop in loops.items():
        feedbacks = [(settings.get("plugin"), settings) for _, settings in one_or_several(loop, "feedback")]
        controllers = [
            (settings.get("plugin"), settings) for settings in tables(loop, "controllers").values()
        ]
        channels += shape_of(drives_of(loop), feedbacks, controllers).channels(name)
    return (*channels, *TIMING_CHANNELS)


def _check_scene(data: Mapping[str, Any]) -> Iterator[Fault]:
    scene = table(data, "rig").get("scene")
    path: KeyPath = ("rig", "scene")
    keys = scene if isinstance(scene, dict) else {}
    plugin = keys.get("plugin") if keys else scene
    # Importing a scene compiles its physics, which a run on hardware never needs: only its keys are reason enough.
    if (
        keys.keys() <= {"plugin"}
        and isinstance(plugin, str)
        and registry.is_installed("labrun.scenes", plugin)
    ):
        return
    loaded, faults = load_plugin("labrun.scenes", plugin, (*path, "plugin") if keys else path)
    yield from faults
    yield from check_settings(loaded, keys, path, ["plugin"])


def _check_gait(data: Mapping[str, Any]) -> Iterator[Fault]:
    gait = table(data, "gait")
    loaded, faults = load_plugin("labrun.gaits", gait.get("plugin"), ("gait", "plugin"))
    yield from faults
    yield from check_settings(loaded, gait, ("gait",), list(GaitTable.model_fields))
    model = getattr(loaded, "JointKeys", None)
    joints = tables(gait, "joints")
    if gait and gait.get("joints", {}) == {} and gait.get("plugin") != STILL:
        yield Fault(("gait",), "moves no joint: give joints, or leave [gait] out where nothing moves")
    if isinstance(model, type) and issubclass(model, BaseModel):
        for joint, keys in joints.items():
            yield from validate(model, keys, ("gait", "joints", joint))[1]
    has_cycle = getattr(loaded, "has_cycle", None)
    length = next((key for key in ("cycles", "until") if key in table(data, "trial")), None)
    if "gait" not in data and length is not None:
        yield Fault(("trial", length), "without [gait] the trial has no cycle to count; give duration_s")
    if not joints or length is None or has_cycle is None:
        return
    if not has_cycle(joints):
        plugin = gait["plugin"]
        advice = (
            "give frequency_hz to one of its joints, or a duration_s"
            if "frequency_hz" in getattr(model, "model_fields", ())
            else "give duration_s"
        )
        yield Fault(("trial", length), f'the gait "{plugin}" has no cycle to count; {advice}')


def _check_objective(
    objective: Mapping[str, Any], path: KeyPath, devices: Mapping[str, DeviceInfo]
) -> Iterator[Fault]:
    loaded, faults = load_plugin("labrun.objectives", objective.get("plugin"), (*path, "plugin"))
    yield from faults
    yield from check_settings(loaded, objective, path, list(ObjectiveTable.model_fields))
    yield from check_channel(objective.get("channel"), (*path, "channel"), devices)
    if getattr(loaded, "needs_channel", False) and objective.get("channel") is None:
        yield Fault(path, 'the key "channel" is missing: name the channel that this number is made of')
    for key in getattr(loaded, "channel_settings", ()):
        value = objective.get(key)
        for channel in value if isinstance(value, list) else [value]:
            yield from check_channel(channel, (*path, key), devices)
