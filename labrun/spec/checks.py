"""What has to fit together across the tables of a file.

Works on the file as it was read, not on the validated experiment, so that these problems are reported together with all
the others. Whatever has the wrong shape is passed over here: validation reports it.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from labrun.errors import SpecError
from labrun.spec.catalogue import DeviceInfo, examine
from labrun.spec.channels import check_channel
from labrun.spec.fit_checks import check_fit, check_gap
from labrun.spec.plugin_checks import check_plugins, gait_names
from labrun.spec.raw_tables import check_expression, condition_names, driven_names, listed_conditions, table
from labrun.spec.track_checks import check_track
from labrun.spec.unit_checks import check_units
from labrun.toml import CONSTANTS, FUNCTIONS, Expression, Fault, KeyPath, in_order, nearest, suggest


def cross_check(data: Mapping[str, Any], path: Path | None = None) -> list[Fault]:
    """Return everything that does not fit together.

    Parameters
    ----------
    data
        The file as it was read.
    path
        The file; without it (a spec stored with a run) nothing beside it is looked for.
    """
    problems: list[Fault] = []
    devices: dict[str, DeviceInfo] = {}
    for name, device in table(data, "rig", "devices").items():
        if isinstance(device, dict):
            devices[name], found = examine(name, device)
            problems += found
    conditions = condition_names(data)
    problems += check_plugins(data, devices)
    problems += check_fit(data, path)
    problems += check_gap(data, path)
    problems += _check_joints(data, devices)
    problems += _check_references(data, devices)
    problems += _check_conditions(data, conditions)
    problems += check_track(data, devices, conditions)
    problems += check_units(data, [*conditions, *driven_names(data)])
    problems += _check_expressions(data, conditions)
    return problems


def _check_joints(data: Mapping[str, Any], devices: Mapping[str, DeviceInfo]) -> Iterator[Fault]:
    drivers: dict[str, str] = {}
    for name, device in devices.items():
        for joint in device.joints:
            if joint in drivers:
                path: KeyPath = ("rig", "devices", name)
                yield Fault(path, f'joint "{joint}" is driven by {drivers[joint]} already')
            drivers.setdefault(joint, name)
    for where in (("gait", "joints"), ("trial", "safe_pose_deg")):
        for joint in table(data, *where):
            if joint not in drivers:
                yield Fault(
                    (*where, joint), f"no device drives this joint; {suggest(joint, drivers, kind='joints')}"
                )


def _check_references(data: Mapping[str, Any], devices: Mapping[str, DeviceInfo]) -> Iterator[Fault]:
    objectives = table(data, "objectives")
    trial = table(data, "trial")
    channel = table(trial, "settle").get("channel")
    yield from check_channel(channel, ("trial", "settle", "channel"), devices)
    for name in table(trial, "repeats", "standard_error"):
        if name not in objectives:
            path: KeyPath = ("trial", "repeats", "standard_error", name)
            yield Fault(path, f"no objective of this name; {suggest(name, objectives, kind='objectives')}")
    outlier = table(trial, "outliers").get("objective")
    if isinstance(outlier, str) and outlier not in objectives:
        path = ("trial", "outliers", "objective")
        yield Fault(
            path, f"no objective of this name; {suggest(outlier, objectives, kind='objectives')}", True
        )
    yield from _check_device_names(trial, devices)
    joints = table(data, "gait", "joints")
    for signal, path in (
        (signal, (owner, "signals", name))
        for owner in ("fit", "gap")
        for name, signal in table(data, owner, "signals").items()
    ):
        if isinstance(signal, str) and signal.startswith("command."):
            joint = signal.removeprefix("command.")
            if joint not in joints:
                yield Fault(
                    path, f'the gait has no joint "{joint}"; {suggest(joint, joints, kind="joints")}', True
                )
        else:
            yield from check_channel(signal, path, devices)


def _check_device_names(trial: Mapping[str, Any], devices: Mapping[str, DeviceInfo]) -> Iterator[Fault]:
    carriage = table(trial, "carriage").get("device")
    path: KeyPath = ("trial", "carriage", "device")
    if isinstance(carriage, str):
        able = [name for name, device in devices.items() if device.carriage is not False]
        if carriage not in devices:
            yield Fault(
                path, f"no device of this name; {suggest(carriage, able or devices, kind='devices')}", True
            )
        elif carriage not in able:
            yield Fault(path, f"this device cannot travel; {suggest(carriage, able, kind='carriages')}", True)
    tared = table(trial, "tare").get("devices")
    for number, name in enumerate(tared if isinstance(tared, list) else []):
        if isinstance(name, str) and name not in devices:
            path = ("trial", "tare", "devices", number)
            yield Fault(path, f"no device of this name; {suggest(name, devices, kind='devices')}", True)


def _check_conditions(data: Mapping[str, Any], names: list[str]) -> Iterator[Fault]:
    for kind in ("run", "track"):
        for number, condition in enumerate(listed_conditions(data, kind)):
            yield from _same_names(condition, (kind, "conditions", number), names)
    reference = table(data, "trial", "reference").get("condition")
    if isinstance(reference, dict):
        yield from _same_names(reference, ("trial", "reference", "condition"), names)
    let = table(data, "gait", "let")
    for name in names:
        taken = "a part of let" if name in let else "a function" if name in FUNCTIONS else None
        if taken or name in CONSTANTS:
            yield Fault(
                _condition_path(data, name), f"this name is taken: it is also {taken or 'a constant'}"
            )


def _condition_path(data: Mapping[str, Any], name: str) -> KeyPath:
    paths: dict[str, KeyPath] = {"sweep": ("sweep", "axes", name), "cmaes": ("cmaes", "variables", name)}
    listed = "track" if data.get("kind") == "track" else "run"
    return paths.get(str(data.get("kind")), (listed, "conditions", 0, name))


def _same_names(condition: Mapping[str, Any], path: KeyPath, names: list[str]) -> Iterator[Fault]:
    unknown = [name for name in condition if name not in names]
    free = [known for known in names if known not in condition]
    for name in unknown:
        yield Fault(
            (*path, name), f"no condition has this name; {suggest(name, free or names, kind='names')}"
        )
    meant = {nearest(name, free) for name in unknown}
    missing = [name for name in free if name not in meant]
    if missing and len(unknown) < len(free):  # else each that is missing is there under a wrong name
        yield Fault(path, f"lacks a value for {', '.join(missing)}")


def _check_expressions(data: Mapping[str, Any], conditions: list[str]) -> Iterator[Fault]:
    let = table(data, "gait", "let")
    own = gait_names(data)
    in_gait = [*conditions, *let, *own, *driven_names(data)]
    for name, expression in let.items():
        yield from check_expression(expression, ("gait", "let", name), in_gait)
    try:
        in_order({name: item for name, item in let.items() if isinstance(item, str | float | int)})
    except SpecError as error:
        if "circle" in str(error):
            yield Fault(("gait", "let"), str(error))
    for joint, keys in table(data, "gait", "joints").items():
        for key, expression in (keys if isinstance(keys, dict) else {}).items():
            yield from check_expression(expression, ("gait", "joints", joint, key), in_gait)
    speed = table(data, "trial", "carriage").get("speed_m_s")
    yield from check_expression(speed, ("trial", "carriage", "speed_m_s"), conditions)
    for kind, names in (
        ("sweep", table(data, "sweep", "axes")),
        ("cmaes", table(data, "cmaes", "variables")),
    ):
        where = table(data, kind).get("where")
        for number, expression in enumerate(where if isinstance(where, list) else []):
            path: KeyPath = (kind, "where", number)
            found = list(check_expression(expression, path, list(names)))
            if not found and isinstance(expression, str) and not Expression.of(expression).is_comparison:
                found.append(
                    Fault(path, 'compares nothing; a constraint reads "a + abs(b) <= 60"', at_value=True)
                )
            yield from found
