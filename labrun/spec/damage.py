"""What a trial does to its specimen: conditions that take it past its limit, and numbers that tell it broke."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import Field, model_validator

from labrun.spec.raw import check_expression, check_name, table
from labrun.toml import Expression, ExpressionError, Fault, KeyPath, Table, TableFaults

PAST = "past its limit"
BROKEN = "broken"


class DamageTable(Table):
    """When a specimen is no longer what it was.

    Conditions for which `when` holds take it past its limit: they come last, and only with `allow_damage`. It is broken
    once `broken` holds for a trial's objectives. Nothing more is measured on it then. `of` names what tells specimens
    apart: all that is set by hand, if not said. What earlier runs did counts, unless specimens are `fresh` ones
    under the old names.
    """

    of: list[str] = Field(default_factory=list)
    when: Expression | None = None
    broken: Expression | None = None
    allow_damage: bool = False
    fresh: bool = False

    @model_validator(mode="after")
    def _says_something(self) -> "DamageTable":
        with TableFaults() as faults:
            if self.when is None and self.broken is None:
                faults.add(None, "says nothing: give when, broken, or both", of=("when", "broken"))
        return self


def check_damage(data: Mapping[str, Any], conditions: list[str]) -> Iterator[Fault]:
    """Yield what does not fit between the table [damage] and the rest of the file."""
    written = table(data, "damage")
    if not written:
        return
    apart = written.get("of")
    for number, name in enumerate(apart if isinstance(apart, list) else []):
        yield from check_name(
            name, ("damage", "of", number), conditions, "no condition has this name", kind="names"
        )
    known = {"when": conditions, "broken": [*conditions, *table(data, "objectives")]}
    for key, names in known.items():
        path: KeyPath = ("damage", key)
        expression = written.get(key)
        yield from check_expression(expression, path, names)
        try:
            compares = not isinstance(expression, str) or Expression.of(expression).is_comparison
        except ExpressionError:
            continue
        if not compares:
            yield Fault(path, 'compares nothing; it reads "reach < 0"', at_value=True)
    if data.get("kind") == "cmaes":
        text = "a search cannot leave what it tries to the end; damage goes with run, sweep and track"
        yield Fault(("damage",), text)
