"""The file as tomllib read it, whatever shape its tables have, and the checks of a single name in it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from labrun.toml import ExpressionError, Fault, KeyPath, fault_of, names_in, nearest, suggest, unit_of


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """One device of the file, as known without connecting it.

    Attributes
    ----------
    joints
        What it drives; empty for what is no actuator.
    channels
        What it measures; None if that cannot be known.
    carriage
        Whether it can travel; None if that cannot be known.
    feels
        Signals of a scene that its stand-in says it looks at, in its attribute `feels`.
    """

    joints: tuple[str, ...]
    channels: tuple[str, ...] | None
    carriage: bool | None
    feels: tuple[str, ...] = ()


def table(data: Any, *path: str) -> dict[str, Any]:
    """Return a table of the file; an empty one if it is not there or is no table."""
    for part in path:
        data = data.get(part) if isinstance(data, Mapping) else None
    return data if isinstance(data, dict) else {}


def tables(data: Any, *path: str) -> dict[str, dict[str, Any]]:
    """Return the tables inside a table of the file by their names, without what is none."""
    return {name: item for name, item in table(data, *path).items() if isinstance(item, dict)}


def condition_names(data: Mapping[str, Any]) -> list[str]:
    """Return the names of a condition's values: axes, variables, or the keys of the listed conditions."""
    sources = {
        "sweep": list(table(data, "sweep", "axes")),
        "cmaes": list(table(data, "cmaes", "variables")),
        "design": list(table(data, "design", "variables")),
        **{kind: next(map(list, listed_conditions(data, kind)), []) for kind in ("run", "track")},
    }
    sources = {
        kind: [*table(data, kind, "each"), *names, *table(data, kind, "over")]
        for kind, names in sources.items()
    }
    kind = data.get("kind")
    if isinstance(kind, str) and kind in sources:
        return sources[kind]
    return list(dict.fromkeys(name for names in sources.values() for name in names))


def driven_names(data: Mapping[str, Any]) -> list[str]:
    """Return the names that the loops of a file drive."""
    return [name for loop in tables(data, "track", "loops").values() for name in drives_of(loop)]


def drives_of(loop: Mapping[str, Any]) -> list[str]:
    """Return the names that a loop's table drives: one, or a list of them."""
    drives = loop.get("drives")
    return [name for name in (drives if isinstance(drives, list) else [drives]) if isinstance(name, str)]


def one_or_several(loop: Mapping[str, Any], key: str) -> list[tuple[KeyPath, dict[str, Any]]]:
    """Return the tables of a loop's reference or feedback, each with its path inside the loop."""
    value = loop.get(key)
    entries = (
        [((key, number), entry) for number, entry in enumerate(value)]
        if isinstance(value, list)
        else [((key,), value)]
    )
    return [(path, entry) for path, entry in entries if isinstance(entry, dict)]


def condition_units(data: Mapping[str, Any]) -> dict[str, str]:
    """Return the units of conditions and variables that a file states: in ``[units]``, else by a key that takes one.

    ``frequency_hz = "f"`` says that `f` is in Hz, and ``offset_deg = "-b"`` that `b` is in degrees. A name that keys
    take in different units has none.
    """
    stated: dict[str, set[str]] = {}
    names = {*condition_names(data), *driven_names(data)}
    for branch in ("rig", "gait", "trial", "design"):
        for key, value in _texts(data.get(branch), branch):
            unit, name = unit_of(key), value.strip().lstrip("+-").strip()
            if unit is not None and name in names:
                stated.setdefault(name, set()).add(unit)
    return {
        **{name: units.pop() for name, units in stated.items() if len(units) == 1},
        **table(data, "units"),
    }


def _texts(data: object, key: str) -> Iterator[tuple[str, str]]:
    """Yield every text of a tree with the last key above it."""
    if isinstance(data, str):
        yield key, data
    elif isinstance(data, Mapping):
        for name, value in data.items():
            yield from _texts(value, str(name))


def asks_for_leaders(conditions: Mapping[str, Any]) -> bool:
    """Tell ``{ leaders_of = "another experiment" }`` from a condition that was written without its list."""
    return any(name.startswith("leader") or name in {"count", "names"} for name in conditions)


def listed_conditions(data: Mapping[str, Any], kind: str) -> list[dict[str, Any]]:
    """Return the conditions that the table of a kind lists one by one."""
    conditions = table(data, kind).get("conditions")
    if isinstance(conditions, dict) and not asks_for_leaders(conditions):  # one that lacks its list
        return [conditions]
    if isinstance(conditions, dict):  # leaders of another run: what they will be called is known, and no more
        names = conditions.get("names")
        return [dict.fromkeys(names, 0.0)] if isinstance(names, list) and names else []
    return [item for item in conditions if isinstance(item, dict)] if isinstance(conditions, list) else []


def places(data: object, pattern: str, path: KeyPath = ()) -> Iterator[tuple[KeyPath, object]]:
    """Yield what stands at the places of a pattern, ``gait.joints.*.*``: a star is every key or entry.

    A ``~`` at its end is every key itself.
    """
    part, _, rest = pattern.partition(".")
    if part == "~":
        yield from (((*path, key), key) for key in (data if isinstance(data, dict) else ()))
    elif part == "*":
        items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
        for key, value in items:
            yield from places(value, rest, (*path, key)) if rest else [((*path, key), value)]
    elif isinstance(data, dict) and part in data:
        yield from places(data[part], rest, (*path, part)) if rest else [((*path, part), data[part])]


GAIT_EXPRESSIONS = "gait.joints.*.*"


def check_name(
    name: object, path: KeyPath, known: Mapping[str, Any] | list[str], message: str, *, kind: str
) -> Iterator[Fault]:
    """Yield `message` with the nearest known name, for an unknown name."""
    if isinstance(name, str) and name not in known:
        yield Fault(path, f"{message}; {suggest(name, known, kind=kind)}", at_value=path[-1] != name)


def named_channels(settings: Mapping[str, Any], key: str) -> list[tuple[KeyPath, str]]:
    """Return the channels that a plugin's key names, with their paths: one, a list or a table of them.

    A key inside a table of the plugin is written ``"table.key"``.
    """
    *outer, last = key.split(".")
    value = table(settings, *outer).get(last)
    path: KeyPath = (*outer, last)
    if isinstance(value, Mapping):
        entries = [((*path, name), entry) for name, entry in value.items()]
    else:
        entries = [(path, entry) for entry in (value if isinstance(value, list) else [value])]
    return [(key_path, entry) for key_path, entry in entries if isinstance(entry, str)]


def check_channel(channel: object, path: KeyPath, devices: Mapping[str, DeviceInfo]) -> Iterator[Fault]:
    """Yield faults of a channel name, "device.channel"."""
    if not isinstance(channel, str):
        return
    if any("." in device and channel.startswith(f"{device}.") for device in devices):
        return  # the name of the device is at fault, and reported
    name, _, signal = channel.partition(".")
    known = [f"{key}.{item}" for key, device in devices.items() for item in device.channels or ()]
    if name not in devices:
        near = nearest(channel, known)
        hint = f'did you mean "{near}"?' if near else suggest(name, devices, kind="devices")
        yield Fault(path, f'unknown device "{name}"; {hint}', at_value=True)
        return
    channels = devices[name].channels
    if not signal:
        hint = suggest(channel, known, kind="channels")
        yield Fault(path, f'a channel is written "device.channel"; {hint}', at_value=True)
    elif channels is not None and signal not in channels:
        own = [f"{name}.{item}" for item in channels]
        hint = suggest(channel, own, kind="channels") if own else f"{name} measures nothing"
        yield Fault(path, f'{name} has no channel "{signal}"; {hint}', at_value=True)


def check_expression(expression: object, path: KeyPath, known: list[str]) -> Iterator[Fault]:
    """Yield why an expression cannot be read, or which of its names are not among the known; numbers pass."""
    if not isinstance(expression, str):
        return
    try:
        needed = names_in(expression)
    except ExpressionError as error:
        yield Fault(path, fault_of(error), at_value=True)
        return
    for name in sorted(needed - set(known)):
        yield Fault(path, f'unknown name "{name}"; {suggest(name, known, kind="names")}', at_value=True)
