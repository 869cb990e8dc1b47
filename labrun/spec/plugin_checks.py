"""Scene, gait and objectives of a file: whether their plugins are there, and their keys hold."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from labrun import registry
from labrun.errors import PluginError
from labrun.spec.catalogue import DeviceInfo
from labrun.spec.channels import check_channel
from labrun.spec.experiment import GaitTable, ObjectiveTable
from labrun.spec.raw_tables import table
from labrun.spec.track_tables import LOOP_DEVICE, loop_channels
from labrun.toml import Fault, KeyPath, suggest, validate


def load_plugin(group: str, plugin: object, path: KeyPath) -> tuple[Any, list[Fault]]:
    """Return a plugin's class, or why there is none; both empty if no plugin is named."""
    if not isinstance(plugin, str):
        return None, []
    if ":" not in plugin and not registry.is_installed(group, plugin):
        kind = group.removeprefix("labrun.").removesuffix("s")
        known = registry.names(group)
        return None, [Fault(path, f"unknown {kind} plugin; {suggest(plugin, known, kind='installed')}", True)]
    try:
        return registry.load(group, plugin), []
    except PluginError as error:
        return None, [Fault(path, str(error).replace("\n  ", "; "), at_value=True)]


def gait_names(data: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names that the file's gait itself gives to expressions, such as the time ``t`` of a formula."""
    plugin = table(data, "gait").get("plugin")
    gait, _ = load_plugin("labrun.gaits", plugin, ())
    return tuple(getattr(gait, "names", ()))


def loop_device(data: Mapping[str, Any]) -> dict[str, DeviceInfo]:
    """Return what the loops of a file record, as if a device did: an objective may look at it."""
    loops = table(data, "track", "loops")
    if data.get("kind") != "track" or not loops:
        return {}
    return {LOOP_DEVICE: DeviceInfo(joints=(), channels=loop_channels(list(loops)), carriage=False)}


def check_plugins(data: Mapping[str, Any], devices: Mapping[str, DeviceInfo]) -> Iterator[Fault]:
    """Yield what is wrong with scene, gait and objectives, apart from what other tables have to do with."""
    yield from _check_scene(data)
    yield from _check_gait(data)
    devices = {**devices, **loop_device(data)}
    for name, objective in table(data, "objectives").items():
        if isinstance(objective, dict):
            yield from _check_objective(objective, ("objectives", name), devices)


def _check_scene(data: Mapping[str, Any]) -> Iterator[Fault]:
    scene = table(data, "rig").get("scene")
    path: KeyPath = ("rig", "scene")
    plugin = scene.get("plugin") if isinstance(scene, dict) else scene
    keys = scene if isinstance(scene, dict) else {}
    at: KeyPath = (*path, "plugin") if isinstance(scene, dict) else path
    if not isinstance(plugin, str):
        return
    # Importing a scene compiles its physics, which a run on hardware never needs: only its keys are reason enough.
    if keys.keys() <= {"plugin"} and registry.is_installed("labrun.scenes", plugin):
        return
    loaded, problems = load_plugin("labrun.scenes", plugin, at)
    yield from problems
    yield from check_settings(loaded, keys, path, ["plugin"])


def check_settings(plugin: Any, keys: Mapping[str, Any], path: KeyPath, own: list[str]) -> Iterator[Fault]:
    """Yield what is wrong with a plugin's keys; those of `own` are read by someone else."""
    model = getattr(plugin, "Settings", None)
    if isinstance(model, type) and issubclass(model, BaseModel):
        settings = {key: value for key, value in keys.items() if key not in own}
        yield from validate(model, settings, path, also=own)[1]


def _check_gait(data: Mapping[str, Any]) -> Iterator[Fault]:
    gait = table(data, "gait")
    loaded, problems = load_plugin("labrun.gaits", gait.get("plugin"), ("gait", "plugin"))
    yield from problems
    yield from check_settings(loaded, gait, ("gait",), list(GaitTable.model_fields))
    model = getattr(loaded, "JointKeys", None)
    joints = {joint: keys for joint, keys in table(gait, "joints").items() if isinstance(keys, dict)}
    if isinstance(model, type) and issubclass(model, BaseModel):
        for joint, keys in joints.items():
            yield from validate(model, keys, ("gait", "joints", joint))[1]
    cycles = table(data, "trial").get("cycles")
    has_cycle = getattr(loaded, "has_cycle", None)
    if cycles is not None and has_cycle is not None and not has_cycle(joints):
        plugin = gait["plugin"]
        advice = (
            "give frequency_hz to one of its joints, or a duration_s"
            if "frequency_hz" in _keys(model)
            else "give duration_s"
        )
        yield Fault(("trial", "cycles"), f'the gait "{plugin}" has no cycle to count; {advice}')


def _keys(model: Any) -> list[str]:
    return list(model.model_fields) if model is not None else []


def _check_objective(
    objective: Mapping[str, Any], path: KeyPath, devices: Mapping[str, DeviceInfo]
) -> Iterator[Fault]:
    loaded, problems = load_plugin("labrun.objectives", objective.get("plugin"), (*path, "plugin"))
    yield from problems
    yield from check_settings(loaded, objective, path, list(ObjectiveTable.model_fields))
    yield from check_channel(objective.get("channel"), (*path, "channel"), devices)
    if getattr(loaded, "needs_channel", False) and objective.get("channel") is None:
        yield Fault(path, 'the key "channel" is missing: which channel this number is made of')
    for key in getattr(loaded, "channel_settings", ()):
        yield from check_channel(objective.get(key), (*path, key), devices)
