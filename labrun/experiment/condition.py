"""A condition: the values a trial is run under, as a key and in words."""

from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import Annotated

from pydantic import AfterValidator, Field

Number = float | int
"""A number of the file; whole ones stay whole."""


def _ordered(pair: list[Number]) -> list[Number]:
    if not pair[0] < pair[1]:
        raise ValueError(f"expected [low, high]; {pair[0]:g} is not below {pair[1]:g}")
    return pair


Bounds = Annotated[list[Number], Field(min_length=2, max_length=2), AfterValidator(_ordered)]
"""``[low, high]``."""
Value = float | str
"""A value of a condition: a number, or a word (a specimen's name)."""
Condition = Mapping[str, Value]
"""Values of one trial, by name, in the units of the file."""

NO_UNITS: Mapping[str, str] = MappingProxyType({})
"""Where the units of a condition are not known, or stand elsewhere."""


def condition_key(condition: Condition) -> tuple[tuple[str, Value], ...]:
    """Return a hashable form: equal conditions have equal keys, whatever the order of their names."""
    return tuple(sorted(condition.items(), key=lambda item: item[0]))


def varying(conditions: Iterable[Condition]) -> list[str]:
    """Return the names whose value is not the same in all conditions; all names where none varies."""
    listed = list(conditions)
    names = list(dict.fromkeys(name for condition in listed for name in condition))
    return [name for name in names if len({condition.get(name) for condition in listed}) > 1] or names


def only(condition: Condition, names: Collection[str]) -> dict[str, Value]:
    """Return the part of a condition with these names."""
    return {name: value for name, value in condition.items() if name in names}


def condition_text(condition: Condition, units: Mapping[str, str] = NO_UNITS, *, digits: int = 6) -> str:
    """Return ``a = 20 deg, f = 1.2 Hz, fin = soft``; without units where they are not known."""
    return ", ".join(
        f"{name} = {value_text(value, units.get(name, ''), digits=digits)}"
        for name, value in condition.items()
    )


def value_text(value: Value, unit: str = "", *, digits: int = 6) -> str:
    """Return ``0.3 Hz``; the unit "1" is none, and words have none."""
    if not isinstance(value, int | float):
        return value
    number = f"{value:.{digits}g}"
    return number if unit in ("", "1") else f"{number} {unit}"
