"""Writing a table as TOML such that reading it gives its keys back in their order."""

from collections.abc import Iterator, Mapping
from typing import Any

import tomli_w

_LINE = 100
"""A list of tables longer than this is written with one table a line."""


def written_in_order(table: Mapping[str, Any]) -> str:
    """Return a table as TOML that reads back as an equal table with all keys in the same order.

    TOML lists the plain values of a table before its sub-tables. A sub-table that stands before a plain value is
    therefore written with dotted keys (``a.from = 10``), all others under headings. The order has a meaning: the axes
    of a sweep are crossed in theirs.
    """
    return "\n".join(_section((), table)).strip() + "\n"


def _section(path: tuple[str, ...], table: Mapping[str, Any]) -> Iterator[str]:
    plain = [index for index, value in enumerate(table.values()) if not isinstance(value, Mapping)]
    count = plain[-1] + 1 if plain else 0
    items = list(table.items())
    if path and (count or not items):
        yield f"[{_key(path)}]"
    for key, value in items[:count]:
        yield from _assignments((key,), value)
    if count or not items:
        yield ""
    for key, value in items[count:]:
        yield from _section((*path, key), value)


def _assignments(path: tuple[str, ...], value: Any) -> Iterator[str]:
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _assignments((*path, key), inner)
    else:
        yield f"{_key(path)} = {_value(value)}"


def _key(path: tuple[str, ...]) -> str:
    return ".".join(tomli_w.dumps({part: 0}).removesuffix(" = 0\n") for part in path)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        pairs = (f"{_key((key,))} = {_value(inner)}" for key, inner in value.items())
        return f"{{ {', '.join(pairs)} }}" if value else "{}"
    if isinstance(value, list | tuple):
        items = [_value(item) for item in value]
        line = f"[{', '.join(items)}]"
        tables = any(isinstance(item, Mapping) for item in value)
        return line if len(line) <= _LINE or not tables else "[\n    " + ",\n    ".join(items) + ",\n]"
    return tomli_w.dumps({"a": value}).removeprefix("a = ").removesuffix("\n")
