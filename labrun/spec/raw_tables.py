"""Tables of a file as tomllib read it, whatever shape they have."""

from collections.abc import Iterator, Mapping
from typing import Any

from labrun.toml import ExpressionError, Fault, KeyPath, fault_of, names_in, suggest


def table(data: Any, *path: str) -> dict[str, Any]:
    """Return a table of the file; an empty one if it is not there or is no table."""
    for part in path:
        data = data.get(part) if isinstance(data, Mapping) else None
    return data if isinstance(data, dict) else {}


def condition_names(data: Mapping[str, Any]) -> list[str]:
    """Return the names of a condition's values: axes, variables, or the keys of the listed conditions."""
    sources = {
        "sweep": list(table(data, "sweep", "axes")),
        "cmaes": list(table(data, "cmaes", "variables")),
        "run": _first_names(data, "run"),
        "track": _first_names(data, "track"),
    }
    kind = data.get("kind")
    if isinstance(kind, str) and kind in sources:
        return sources[kind]
    return list(dict.fromkeys(name for names in sources.values() for name in names))


def driven_names(data: Mapping[str, Any]) -> list[str]:
    """Return the names that the loops of a file drive."""
    loops = table(data, "track", "loops")
    found = [table(loops, name).get("drives") for name in loops]
    return [name for name in found if isinstance(name, str)]


def _first_names(data: Mapping[str, Any], kind: str) -> list[str]:
    return next((list(condition) for condition in listed_conditions(data, kind)), [])


def listed_conditions(data: Mapping[str, Any], kind: str = "run") -> list[dict[str, Any]]:
    """Return the conditions that the table of a kind lists one by one."""
    conditions = table(data, kind).get("conditions")
    return [item for item in conditions if isinstance(item, dict)] if isinstance(conditions, list) else []


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
