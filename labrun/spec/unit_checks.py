"""The table [units]: names of conditions, units that exist, and no contradiction with the keys of the gait."""

from collections.abc import Iterator, Mapping
from typing import Any

from labrun.spec.raw_tables import table
from labrun.toml import KNOWN_UNITS, Fault, KeyPath, dotted, suggest, unit_of


def check_units(data: Mapping[str, Any], names: list[str]) -> Iterator[Fault]:
    """Yield what is wrong with the units of conditions.

    Parameters
    ----------
    data
        The file as it was read.
    names
        Of the conditions.
    """
    for name, unit in table(data, "units").items():
        path: KeyPath = ("units", name)
        if name not in names:
            yield Fault(path, f"no condition has this name; {suggest(name, names, kind='names')}")
        elif isinstance(unit, str) and unit not in KNOWN_UNITS:
            hint = suggest(unit, KNOWN_UNITS, kind="known units")
            yield Fault(path, f"unknown unit; {hint}", at_value=True)
        elif isinstance(unit, str):
            for key, meant in _given_to(data, name):
                if meant != unit:
                    text = f"{dotted(key)} takes {name} in {meant}"
                    yield Fault(path, text, at_value=True)
                    break


def _given_to(data: Mapping[str, Any], name: str) -> Iterator[tuple[KeyPath, str]]:
    """Yield the keys of the gait whose value is a condition as it stands, with the unit of their names."""
    for joint, keys in table(data, "gait", "joints").items():
        for key, expression in (keys if isinstance(keys, dict) else {}).items():
            unit = unit_of(key)
            if unit is not None and isinstance(expression, str) and expression.strip() == name:
                yield ("gait", "joints", joint, key), unit
