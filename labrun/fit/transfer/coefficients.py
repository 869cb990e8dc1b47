"""Transfer functions as TOML: one table for each response, or the keys alone.

::

    [magnitude]
    gain = 0.0091         # first order: gain, lag_s, dead_s
    lag_s = 0.34
    dead_s = 0.28
    input_unit = "deg"
    output_unit = "N"

    [angle]
    numerator = [-0.87]   # any other: highest power of s first
    denominator = [0.01, 0.2, 1.0]
    dead_s = 0.1

Keys that end in ``_ci95`` are read over: a fit writes its 95 % intervals so.
"""

import math
import tomllib
from collections.abc import Mapping
from typing import Any

import tomli_w

from labrun.errors import RequestError
from labrun.fit.transfer.transfer import Transfer
from labrun.toml import nearest

_FIRST = ("gain", "lag_s")
_GENERAL = ("numerator", "denominator")
_NAMES = ("input_name", "output_name", "input_unit", "output_unit")
_KEYS = (*_FIRST, *_GENERAL, "dead_s", *_NAMES)
_INTERVAL = "_ci95"


def to_table(transfer: Transfer) -> dict[str, Any]:
    """Return a transfer function as the keys of a table."""
    table: dict[str, Any] = {}
    if transfer.is_first_order:
        table |= {"gain": transfer.gain, "lag_s": transfer.lag_s}
    else:
        table |= {"numerator": list(transfer.numerator), "denominator": list(transfer.denominator)}
    table["dead_s"] = transfer.dead_s
    return table | {key: getattr(transfer, key) for key in _NAMES if getattr(transfer, key)}


def to_toml(transfer: Transfer) -> str:
    """Return a transfer function as TOML, its keys at the top."""
    return tomli_w.dumps(to_table(transfer))


def responses_toml(tables: Mapping[str, Mapping[str, Any]], comment: str) -> str:
    """Return a TOML table for each response, below a comment."""
    said = "".join(f"# {line}\n" for line in comment.splitlines())
    return said + "\n" + tomli_w.dumps({name: dict(table) for name, table in tables.items()})


def from_toml(text: str, response: str | None = None, *, name: str = "transfer function") -> Transfer:
    """Read a transfer function; see `Transfer.from_toml`."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RequestError(f"{name}: not TOML: {error}") from None
    path: tuple[str, ...] = ()
    alone = any(not isinstance(value, dict) for value in data.values())
    tables = {key: value for key, value in data.items() if isinstance(value, dict)}
    if alone and response is None:
        table = data
    else:
        chosen = _chosen(tables, response, name)
        table, path = tables[chosen], (chosen,)
    return _Reader(text, name, path).read(table)


def _chosen(tables: Mapping[str, Any], response: str | None, name: str) -> str:
    if response is not None and response in tables:
        return response
    known = ", ".join(tables)
    if not tables:
        raise RequestError(f"{name}: holds no transfer function", hint="give it gain, lag_s and dead_s")
    if response is not None:
        near = nearest(response, tables)
        hint = f"did you mean {near!r}?" if near else f"it has {known}"
        raise RequestError(f"{name}: has no response {response!r}", hint=hint)
    if len(tables) > 1:
        raise RequestError(f"{name}: holds several transfer functions", hint=f"say which one: {known}")
    return next(iter(tables))


class _Reader:
    """Reads one table, and says where in the text something is wrong."""

    def __init__(self, text: str, name: str, path: tuple[str, ...]) -> None:
        self._text, self._name, self._path = text, name, path

    def read(self, table: Mapping[str, Any]) -> Transfer:
        for key in table:
            if key not in _KEYS and not key.endswith(_INTERVAL):
                near = nearest(key, _KEYS)
                expected = f"did you mean {near!r}?" if near else f"known are {', '.join(_KEYS)}"
                raise self._wrong(key, "is not a key of a transfer function", expected)
        names = {key: self._text_of(table, key) for key in _NAMES if key in table}
        dead_s = self._number(table, "dead_s", 0.0)
        if dead_s < 0:
            raise self._wrong("dead_s", f"must be 0 or more, s, not {dead_s:g}")
        first, general = ([key for key in keys if key in table] for keys in (_FIRST, _GENERAL))
        if first and general:
            raise self._wrong(
                general[0],
                f"and {first[0]} are two ways to write one: keep gain and lag_s, or both polynomials",
            )
        if general:
            above, below = self._numbers(table, "numerator"), self._numbers(table, "denominator")
            if not any(below):
                raise self._wrong("denominator", "must not be all zeros")
            if len(Transfer(above, (1.0,) * len(above)).numerator) > len(Transfer((0.0,), below).denominator):
                raise self._wrong("numerator", "must not be of higher order than the denominator")
            return Transfer(above, below, dead_s, **names)
        lag_s = self._number(table, "lag_s")
        if lag_s <= 0:
            raise self._wrong("lag_s", f"must be above 0 s, not {lag_s:g}")
        return Transfer.first_order(self._number(table, "gain"), lag_s, dead_s, **names)

    def _number(self, table: Mapping[str, Any], key: str, default: float | None = None) -> float:
        value = table.get(key, default)
        if value is None:
            raise self._wrong(key, "is missing", "a first-order one has gain, lag_s and dead_s")
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self._wrong(key, f"must be a finite number, not {value!r}")
        return float(value)

    def _numbers(self, table: Mapping[str, Any], key: str) -> tuple[float, ...]:
        value = table.get(key)
        if value is None:
            raise self._wrong(key, "is missing", "a transfer function has a numerator and a denominator")
        if not isinstance(value, list) or not value:
            raise self._wrong(key, f"must be a list of numbers, highest power of s first, not {value!r}")
        return tuple(self._number({key: one}, key) for one in value)

    def _text_of(self, table: Mapping[str, Any], key: str) -> str:
        if not isinstance(table[key], str):
            raise self._wrong(key, f"must be a text, not {table[key]!r}")
        return str(table[key])

    def _wrong(self, key: str, message: str, hint: str | None = None) -> RequestError:
        from labrun.toml import locate

        at = locate(self._text).of_key((*self._path, key))
        return RequestError(f"{self._name}:{at.line}:{at.column}: {key} {message}", hint=hint)
