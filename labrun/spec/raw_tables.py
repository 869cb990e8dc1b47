"""Tables of a file as tomllib read it, whatever shape they have."""

from collections.abc import Mapping
from typing import Any


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
        "run": list(listed_conditions(data)[0]) if listed_conditions(data) else [],
    }
    kind = data.get("kind")
    if isinstance(kind, str) and kind in sources:
        return sources[kind]
    return list(dict.fromkeys(name for names in sources.values() for name in names))


def listed_conditions(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the conditions of a run that are listed one by one."""
    conditions = table(data, "run").get("conditions")
    return [item for item in conditions if isinstance(item, dict)] if isinstance(conditions, list) else []
