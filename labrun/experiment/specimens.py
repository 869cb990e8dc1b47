"""What tells specimens apart, [by_hand], and what damages them, [damage]."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field, PositiveInt, model_validator

from labrun.experiment.condition import Condition, value_text
from labrun.experiment.raw import check_expression, listed_conditions, table
from labrun.toml import Expression, ExpressionError, Fault, KeyPath, Table, TableFaults, suggest

_PLACE = re.compile(r"\{([^{}]*)\}")


class ByHand(Table):
    """Values of a condition that somebody has to see to: a specimen, a mass, the level in a tank.

    Trials are measured in blocks of equal values, one a mounting; `ask` is what the person is told at each.
    """

    names: Annotated[list[str], Field(min_length=1)]
    ask: str = ""
    mountings: PositiveInt = 1

    def values(self, condition: Condition) -> Condition:
        """Return what of a condition is set by hand."""
        return {name: condition[name] for name in self.names if name in condition}

    def instruction(self, values: Condition, units: Mapping[str, str]) -> str:
        """Return the instruction to the person, with the values filled in."""
        texts = {name: value_text(value, units.get(name, "")) for name, value in values.items()}
        if not self.ask:
            return "Set " + ", ".join(f"{name} = {text}" for name, text in texts.items())
        return _PLACE.sub(lambda match: texts.get(match[1], match[0]), self.ask)


def check_by_hand(data: Mapping[str, Any]) -> Iterator[Fault]:
    """Yield what does not fit between the table [by_hand] and the rest of the file."""
    written = table(data, "by_hand")
    given = written.get("names")
    names = [name for name in given if isinstance(name, str)] if isinstance(given, list) else []
    if not names:
        return
    for number, name in enumerate(names):
        path: KeyPath = ("by_hand", "names", number)
        if name in names[:number]:
            yield Fault(path, f'"{name}" is listed twice; remove one', at_value=True)
    ask = written.get("ask")
    for placeholder in _PLACE.findall(ask) if isinstance(ask, str) else ():
        if placeholder not in names:
            suggestion = suggest(placeholder, names, kind="names")
            text = f"{{{placeholder}}} is not in by_hand.names; {suggestion}"
            yield Fault(("by_hand", "ask"), text, at_value=True)
    each = table(data, "cmaes", "each")
    if data.get("kind") == "cmaes" and not all(name in each for name in names):
        yield Fault(
            ("by_hand",),
            "a search changes its variables with every candidate, too often for a person; in a search, by_hand can "
            "name what cmaes.each has",
        )
    if "reference" in table(data, "trial"):
        text = "a reference every so many trials would change what is mounted; remove it, or by_hand"
        yield Fault(("trial", "reference"), text)
    yield from _check_twice(data, names)


def _check_twice(data: Mapping[str, Any], names: list[str]) -> Iterator[Fault]:
    """Yield what is named twice: a person would be asked for it twice, and nobody meant that."""
    advice = "by_hand.mountings says how often each is mounted, trial.repeats how often it is measured"
    for name in names:
        axis = table(data, "sweep", "axes").get(name)
        listed = axis if isinstance(axis, list) else []
        for value, count in Counter(
            entry for entry in listed if isinstance(entry, str | float | int)
        ).items():
            if count > 1:
                text = f"{value_text(value)} is named {count} times; {advice}"
                yield Fault(("sweep", "axes", name), text, at_value=True)
    for kind in ("run", "track"):
        seen: dict[tuple[tuple[str, str], ...], int] = {}
        for number, condition in enumerate(listed_conditions(data, kind)):
            key = tuple(sorted((name, str(value)) for name, value in condition.items()))
            if key in seen:
                mounted = ", ".join(f"{name} = {condition[name]}" for name in names if name in condition)
                text = f"{mounted} is named twice with the same values, here and as number {seen[key] + 1}; {advice}"
                yield Fault((kind, "conditions", number), text)
            seen.setdefault(key, number)


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
                faults.add(None, "needs when, broken, or both", of=("when", "broken"))
        return self


def check_damage(data: Mapping[str, Any], conditions: list[str]) -> Iterator[Fault]:
    """Yield what does not fit between the table [damage] and the rest of the file."""
    written = table(data, "damage")
    if not written:
        return
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
            yield Fault(path, 'is not a comparison; write for example "reach < 0"', at_value=True)
    if data.get("kind") == "cmaes":
        text = "a search cannot put damaging conditions last; use damage with run, sweep or track"
        yield Fault(("damage",), text)
