"""The table [track]: its plugins, what they read and set, and which controllers its conditions name."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from labrun import registry
from labrun.errors import PluginError
from labrun.experiment.loop_tables import LOOP_DEVICE
from labrun.experiment.plugins import is_expression, load_plugin
from labrun.experiment.raw import (
    GAIT_EXPRESSIONS,
    DeviceInfo,
    check_channel,
    check_expression,
    drives_of,
    listed_conditions,
    named_channels,
    one_or_several,
    places,
    table,
    tables,
)
from labrun.toml import ExpressionError, Fault, KeyPath, names_in, suggest, validate

_GAITS = "labrun.gaits"


def check_track(
    data: Mapping[str, Any], devices: Mapping[str, DeviceInfo], conditions: list[str]
) -> Iterator[Fault]:
    """Yield what is wrong with the loops of a file, apart from the shape of their tables.

    `data`: the file as it was read. `devices`: what it connects. `conditions`: names of the values of a condition.
    """
    loops = tables(data, "track", "loops")
    if data.get("kind") != "track" or not loops:
        return
    if LOOP_DEVICE in devices:
        yield Fault(
            ("rig", "devices", LOOP_DEVICE),
            "this name is reserved for what the loops record; choose another name",
        )
    yield from _check_gait(data)
    drivers: dict[str, str] = {}
    for name, loop in loops.items():
        path: KeyPath = ("track", "loops", name)
        if not name.replace("-", "_").isidentifier():
            yield Fault(
                path,
                "invalid name of a loop: use letters, digits, '-' and '_'; its channels are named after it",
            )
        for drives in drives_of(loop):
            yield from _check_drive(data, name, drives, drivers, conditions)
        for inner, keys in one_or_several(loop, "reference"):
            yield from _check_part("labrun.references", keys, (*path, *inner), conditions)
        for inner, keys in one_or_several(loop, "feedback"):
            yield from _check_part("labrun.feedbacks", keys, (*path, *inner), None)
            yield from _check_feedback(data, keys, (*path, *inner), devices)
        for controller, keys in table(loop, "controllers").items():
            here: KeyPath = (*path, "controllers", controller)
            yield from _check_part("labrun.controllers", keys, here, conditions)
            if isinstance(keys, dict):
                yield from _check_channels("labrun.controllers", keys, here, devices)
    yield from _check_named_controllers(data, loops)


def _check_gait(data: Mapping[str, Any]) -> Iterator[Fault]:
    plugin = table(data, "gait").get("plugin")
    gait, _ = load_plugin(_GAITS, plugin, ())
    if gait is not None and not hasattr(gait, "steering"):
        able = ", ".join(sorted(_steerable()))
        yield Fault(("gait", "plugin"), f"a loop cannot steer this gait; it can steer {able}", at_value=True)


def _steerable() -> Iterator[str]:
    for name in registry.names(_GAITS):
        try:
            if hasattr(registry.load(_GAITS, name), "steering"):
                yield name
        except PluginError:  # broken, and not the one that is asked for
            continue


def _check_drive(
    data: Mapping[str, Any], name: str, drives: str, drivers: dict[str, str], conditions: list[str]
) -> Iterator[Fault]:
    path: KeyPath = ("track", "loops", name, "drives")
    if drives in drivers:
        yield Fault(
            path, f"the loop {drivers[drives]} drives this already; let one loop drive it", at_value=True
        )
    drivers.setdefault(drives, name)
    gait = table(data, "gait")
    let = table(gait, "let")
    if drives in conditions:
        yield Fault(
            path,
            "the conditions set this value already; remove it there, or drive another name",
            at_value=True,
        )
    elif drives in let:
        yield Fault(
            path, "the gait computes this name in let; drive a name that it uses there", at_value=True
        )
    used: dict[KeyPath, frozenset[str]] = {}
    for key_path, expression in places(data, GAIT_EXPRESSIONS):
        used[key_path] = _needs(expression, let)
    if drives not in frozenset().union(*used.values()):
        free = sorted(frozenset().union(*used.values()) - set(conditions) - set(let) - {"t"})
        yield Fault(
            path, f"the gait does not use this name; {suggest(drives, free, kind='free names')}", True
        )
    plugin, _ = load_plugin(_GAITS, gait.get("plugin"), ())
    for key_path, needed in used.items():
        if drives in needed and key_path[-1] in getattr(plugin, "fixed_keys", ()):
            yield Fault(
                key_path,
                f"depends on {drives}, which the loop {name} drives; a loop cannot change this key",
                at_value=True,
            )


def _needs(expression: object, let: Mapping[str, Any]) -> frozenset[str]:
    """Return the names an expression depends on, through `let` too; none if it cannot be read."""
    needed: set[str] = set()
    left = [expression]
    while left:
        item = left.pop()
        if not isinstance(item, str | float | int):
            continue
        try:
            new = names_in(item) - needed
        except ExpressionError:
            continue
        needed |= new
        left += [let[name] for name in new if name in let]
    return frozenset(needed)


def _check_part(group: str, keys: object, path: KeyPath, conditions: list[str] | None) -> Iterator[Fault]:
    """Check plugin and keys; numbers may be expressions in `conditions`, unless that is None."""
    if not isinstance(keys, dict):
        return
    plugin, problems = load_plugin(group, keys.get("plugin"), (*path, "plugin"))
    yield from problems
    model = getattr(plugin, "Settings", None)
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        return
    settings = {key: value for key, value in keys.items() if key != "plugin"}
    known = [*(conditions or ()), *getattr(plugin, "names", ())]
    for key, value in list(settings.items()):
        whole = key in getattr(plugin, "expression_settings", ())
        if conditions is not None and (whole or is_expression(model, key, value)):
            faults = list(check_expression(value, (*path, key), known))
            yield from faults
            if not whole:  # its value comes with each condition
                settings[key] = 1.0
    yield from validate(model, settings, path, also=["plugin"])[1]


def _check_feedback(
    data: Mapping[str, Any], keys: Mapping[str, Any], path: KeyPath, devices: Mapping[str, DeviceInfo]
) -> Iterator[Fault]:
    yield from _check_channels("labrun.feedbacks", keys, path, devices)
    plugin, _ = load_plugin("labrun.feedbacks", keys.get("plugin"), ())
    gait, _ = load_plugin(_GAITS, table(data, "gait").get("plugin"), ())
    needs_cycle, has_cycle = getattr(plugin, "needs_cycle", None), getattr(gait, "has_cycle", None)
    if needs_cycle is None or has_cycle is None or not needs_cycle(keys):
        return
    if not has_cycle(tables(data, "gait", "joints")):
        yield Fault(
            (*path, "plugin"),
            "the gait has no cycle to average over; give period_s, or use moving-average",
            True,
        )


def _check_channels(
    group: str, keys: Mapping[str, Any], path: KeyPath, devices: Mapping[str, DeviceInfo]
) -> Iterator[Fault]:
    """Yield what is wrong with the channels that a plugin's keys name: one, a list, or a table of them."""
    plugin, _ = load_plugin(group, keys.get("plugin"), ())
    for key in getattr(plugin, "channel_settings", ()):
        for inner, channel in named_channels(keys, key):
            yield from check_channel(channel, (*path, *inner), devices)


def _check_named_controllers(
    data: Mapping[str, Any], loops: Mapping[str, Mapping[str, Any]]
) -> Iterator[Fault]:
    known = list(dict.fromkeys(name for loop in loops.values() for name in table(loop, "controllers")))
    for number, condition in enumerate(listed_conditions(data, "track")):
        path: KeyPath = ("track", "conditions", number)
        named = condition.get("controller")
        if isinstance(named, str) and named not in known:
            yield Fault(
                (*path, "controller"),
                f"no loop has this controller; {suggest(named, known, kind='controllers')}",
                True,
            )
            continue
        for name, loop in loops.items():
            own = table(loop, "controllers")
            if len(own) > 1 and named not in own:
                what = (
                    "names no controller" if named is None else f'the loop {name} has no controller "{named}"'
                )
                choice = " or ".join(f'"{item}"' for item in own)
                yield Fault(path, f"{what}; the loop {name} can take {choice}")
