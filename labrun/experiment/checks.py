"""What has to fit together across the tables of a file.

Works on the file as it was read, not on the validated experiment, so that these faults are reported together with all
the others. Whatever has the wrong shape is passed over here: validation reports it.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from labrun import registry
from labrun.errors import SpecError
from labrun.experiment.plugins import check_plugins, check_settings, examine, load_plugin
from labrun.experiment.raw import (
    GAIT_EXPRESSIONS,
    DeviceInfo,
    check_channel,
    check_expression,
    check_name,
    condition_names,
    driven_names,
    listed_conditions,
    places,
    table,
    tables,
)
from labrun.experiment.search_tables import check_design, is_summary
from labrun.experiment.specimens import check_by_hand, check_damage
from labrun.experiment.track_checks import check_track
from labrun.experiment.trial_tables import check_until
from labrun.experiment.workspace import find_model_file, shipped_experiments
from labrun.toml import (
    CONSTANTS,
    FUNCTIONS,
    KNOWN_UNITS,
    Expression,
    ExpressionError,
    Fault,
    KeyPath,
    dotted,
    in_order,
    names_in,
    nearest,
    suggest,
    unit_of,
)

_NAMES = {
    "condition": ("no condition has this name", "names", ("by_hand.names.*", "damage.of.*", "gap.repeats.*")),
    "objective": (
        "no objective of this name", "objectives", ("trial.repeats.standard_error.~", "trial.outliers.objective"),
    ),
    "device": ("no device of this name", "devices", ("trial.tare.devices.*",)),
    "driven joint": ("no device drives this joint", "joints", ("gait.joints.~", "trial.safe_pose_deg.~")),
    "joint of the gait": (
        "no joint of the gait has this name", "joints", ("trial.average.cycles_of", "cmaes.guard.limits.~"),
    ),
}  # fmt: skip
"""What names something else of the file: what is said of one that is not there, what there is, and its places."""
_CHANNELS = (
    "trial.settle.channel", "trial.within.~", "cmaes.guard.limits.~", "fit.signals.*", "gap.signals.*",
)  # fmt: skip
"""Places of channels; a guard's without a dot is a joint, a signal may be the command of one."""
_EXPRESSIONS = (
    "design.parameters.*", "design.initial.*", "design.parts.*.length_mm", "design.parts.*.width_mm",
    "design.parts.*.angle_deg", "design.writes.*.values.*",
)  # fmt: skip
"""Places of expressions in the variables of a design."""


def cross_check(data: Mapping[str, Any], path: Path | None = None) -> list[Fault]:
    """Return everything that does not fit together.

    `data`: the file as it was read. `path`: the file; without it (a spec stored with a run) nothing beside it is looked
    for.
    """
    faults: list[Fault] = []
    devices: dict[str, DeviceInfo] = {}
    for name, device in tables(data, "rig", "devices").items():
        devices[name], device_faults = examine(name, device)
        faults += device_faults
        if not name or {".", "/"} & set(name):
            text = (
                "invalid device name: use letters, digits, '-' and '_'; its channels are named device.channel"
            )
            faults.append(Fault(("rig", "devices", name), text))
    conditions = condition_names(data)
    faults += check_plugins(data, devices)
    faults += _check_fit(data, path)
    faults += _check_names(data, devices, conditions)
    faults += _check_carriage(data, devices)
    faults += _check_conditions(data, conditions)
    faults += check_by_hand(data)
    faults += check_damage(data, conditions)
    faults += check_until(data)
    faults += check_track(data, devices, conditions)
    faults += check_design(data)
    faults += _check_units(data, [*conditions, *driven_names(data)])
    faults += _check_expressions(data, conditions)
    return faults


def _check_fit(data: Mapping[str, Any], experiment: Path | None) -> Iterator[Fault]:
    """Yield faults of fit methods, settings and model names, without reading a model."""
    fit = table(data, "fit")
    shared = table(fit, "settings")
    plugin, faults = load_plugin(
        "labrun.fits", fit.get("method", "model") if fit else None, ("fit", "method")
    )
    yield from faults
    yield from check_settings(plugin, shared, ("fit", "settings"), [])
    for name, own in tables(fit, "methods").items():
        path: KeyPath = ("fit", "methods", name)
        plugin, faults = load_plugin("labrun.fits", name, path)
        yield from faults
        if plugin is not None:
            taken = {key: value for key, value in shared.items() if key in plugin.Settings.model_fields}
            yield from check_settings(plugin, {**taken, **own}, path, [])
    for owner in ("fit", "gap", "design"):
        yield from _check_model(table(data, owner).get("model"), (owner, "model"), experiment)


def _check_model(model: object, path: KeyPath, experiment: Path | None) -> Iterator[Fault]:
    if experiment is None or not isinstance(model, str):
        return
    if find_model_file(model, experiment, Path()) is not None:
        return
    if model.endswith(".toml"):
        siblings = sorted((experiment.parent / model).parent.glob("*.toml"))
        known = [str(Path(model).parent / item.name) for item in siblings if item != experiment]
        yield from check_name(model, path, known, "no such model file", kind="model files")
    elif ":" in model or registry.is_installed("labrun.models", model):
        yield from load_plugin("labrun.models", model, path)[1]
    else:
        shipped = sorted(item.stem for item in (shipped_experiments() / "models").glob("*.toml"))
        if model not in shipped:
            known = [*shipped, *registry.names("labrun.models")]
            yield from check_name(model, path, known, "no such model", kind="models")


def _check_names(
    data: Mapping[str, Any], devices: Mapping[str, DeviceInfo], conditions: list[str]
) -> Iterator[Fault]:
    """Yield every undefined name."""
    drivers: dict[str, str] = {}
    for name, device in devices.items():
        for joint in device.joints:
            if joint in drivers:
                yield Fault(
                    ("rig", "devices", name),
                    f'joint "{joint}" is driven by {drivers[joint]} already; give each joint to one device',
                )
            drivers.setdefault(joint, name)
    joints = table(data, "gait", "joints")
    known: dict[str, Mapping[str, Any] | list[str]] = {
        "condition": conditions, "objective": table(data, "objectives"), "device": devices, "driven joint": drivers,
        "joint of the gait": joints,
    }  # fmt: skip
    if data.get("kind") == "design":  # it has no devices, and its joints are the model's
        known["driven joint"] = [str(name) for _, name in places(data, "gait.joints.~")]
    for what, (message, kind, patterns) in _NAMES.items():
        for path, named in (entry for pattern in patterns for entry in places(data, pattern)):
            if not (what == "joint of the gait" and "." in str(named)):
                yield from check_name(named, path, known[what], message, kind=kind)
    for path, channel in (entry for pattern in _CHANNELS for entry in places(data, pattern)):
        if path[1] == "signals" and str(channel).startswith("command."):
            joint = str(channel).removeprefix("command.")
            yield from check_name(joint, path, joints, f'the gait has no joint "{joint}"', kind="joints")
        elif path[1] != "guard" or "." in str(channel):
            yield from check_channel(channel, path, devices)


def _check_carriage(data: Mapping[str, Any], devices: Mapping[str, DeviceInfo]) -> Iterator[Fault]:
    carriage = table(data, "trial", "carriage").get("device")
    path: KeyPath = ("trial", "carriage", "device")
    able = [name for name, device in devices.items() if device.carriage is not False]
    if carriage in devices:
        yield from check_name(carriage, path, able, "this device cannot travel", kind="carriages")
    else:
        yield from check_name(carriage, path, able or list(devices), "no device of this name", kind="devices")


def _check_conditions(data: Mapping[str, Any], names: list[str]) -> Iterator[Fault]:
    for kind in ("run", "track"):
        over = table(data, kind, "over")
        own = [name for name in names if name not in over]
        for number, condition in enumerate(listed_conditions(data, kind)):
            yield from _same_names(condition, (kind, "conditions", number), own)
    yield from _check_over(data)
    reference = table(data, "trial", "reference").get("condition")
    if isinstance(reference, dict):
        yield from _same_names(reference, ("trial", "reference", "condition"), names)
    kind = str(data.get("kind"))
    listed: KeyPath = ("track" if kind == "track" else "run", "conditions", 0)
    key_path: KeyPath = {
        "sweep": ("sweep", "axes"),
        "cmaes": ("cmaes", "variables"),
        "design": ("design", "variables"),
    }.get(kind, listed)
    taken = {**dict.fromkeys(CONSTANTS, "a constant"), **dict.fromkeys(FUNCTIONS, "a function")}
    taken |= dict.fromkeys(table(data, "gait", "let"), "a part of let")
    for name in names:
        if name in taken:
            yield Fault((*key_path, name), f"this name is {taken[name]} already; choose another name")


def _check_over(data: Mapping[str, Any]) -> Iterator[Fault]:
    """Yield settings that have a value of their own in every condition already."""
    kind = str(data.get("kind"))
    own = {
        "sweep": table(data, "sweep", "axes"),
        "cmaes": table(data, "cmaes", "variables"),
        "run": next(iter(listed_conditions(data, "run")), {}),
    }.get(kind, {})
    each = table(data, kind, "each")
    for name in table(data, kind, "over"):
        if name in own or name in each:
            text = f'"{name}" is varied already; remove it here, or from what is varied'
            yield Fault((kind, "over", name), text)
    for name in each:
        if name in own:
            text = f'"{name}" is a variable already; remove it here to search over it, or there to search at each level'
            yield Fault((kind, "each", name), text)


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
        yield Fault(path, f"has no value for {', '.join(missing)}")


def _check_units(data: Mapping[str, Any], names: list[str]) -> Iterator[Fault]:
    """Yield faults of condition units: names, units, contradictions with keys of the gait."""
    given = {
        (expression.strip(), unit): path
        for path, expression in places(data, GAIT_EXPRESSIONS)
        if isinstance(expression, str) and (unit := unit_of(str(path[-1]))) is not None
    }
    for name, unit in table(data, "units").items():
        path: KeyPath = ("units", name)
        if name not in names:
            yield from check_name(name, path, names, "no condition has this name", kind="names")
        elif isinstance(unit, str) and unit not in KNOWN_UNITS:
            yield from check_name(unit, path, list(KNOWN_UNITS), "unknown unit", kind="known units")
        else:
            for (expression, meant), key in given.items():
                if expression == name and meant != unit and isinstance(unit, str):
                    yield Fault(
                        path,
                        f"{dotted(key)} takes {name} in {meant}; write that unit, or remove this line",
                        at_value=True,
                    )
                    break


def _check_expressions(data: Mapping[str, Any], conditions: list[str]) -> Iterator[Fault]:
    let = table(data, "gait", "let")
    gait, _ = load_plugin("labrun.gaits", table(data, "gait").get("plugin"), ())
    in_gait = [*conditions, *let, *getattr(gait, "names", ()), *driven_names(data)]
    for path, expression in (*places(data, "gait.let.*"), *places(data, GAIT_EXPRESSIONS)):
        yield from check_expression(expression, path, in_gait)
    try:
        in_order({name: item for name, item in let.items() if isinstance(item, str | float | int)})
    except SpecError as error:
        if "circle" in str(error):
            yield Fault(("gait", "let"), str(error))
    for path, speed in places(data, "trial.carriage.speed_m_s"):
        yield from check_expression(speed, path, conditions)
    if data.get("kind") == "design":
        for path, expression in (entry for pattern in _EXPRESSIONS for entry in places(data, pattern)):
            yield from check_expression(expression, path, list(table(data, "design", "variables")))
    for kind, known in (("sweep", "axes"), ("cmaes", "variables"), ("design", "variables")):
        where = table(data, kind).get("where")
        for number, expression in enumerate(where if isinstance(where, list) else []):
            path = (kind, "where", number)
            names = [*table(data, kind, known), *(_summaries_in(expression) if kind == "design" else ())]
            faults = list(check_expression(expression, path, names))
            if not faults and isinstance(expression, str) and not Expression.of(expression).is_comparison:
                faults.append(
                    Fault(path, 'is not a comparison; write for example "a + abs(b) <= 60"', at_value=True)
                )
            yield from faults


def _summaries_in(expression: object) -> list[str]:
    """Return the names of a constraint that stand for summaries of channels, which only the model can tell."""
    if not isinstance(expression, str):
        return []
    try:
        return [name for name in names_in(expression) if is_summary(name)]
    except ExpressionError:  # told where the expression is checked
        return []
