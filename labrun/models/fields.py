"""Values of a model file, checked as they are read; a fault is told with the line it stands on."""

import keyword
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labrun.errors import ModelError
from labrun.toml import RESERVED, Expression, ExpressionError, KeyPath, locate, suggest

Key = str | KeyPath
"""Names joined by dots, or a path where a name itself has dots or a table is one of an array."""


@dataclass(frozen=True)
class ModelText:
    """The text of a model file and the name it is reported by."""

    name: str
    text: str

    def error(self, key: Key, message: str, hint: str | None = None) -> ModelError:
        """Return an error at a key such as ``"equations.rate"``."""
        line = self.line_of(key)
        where = self.name if line is None else f"{self.name}:{line}"
        shown = _shown(_path(key))
        return ModelError(
            f"{where}: {shown}: {message}" if shown else f"{where}: {message}", hint=hint or None
        )

    def equation_error(self, key: Key, problem: ExpressionError) -> ModelError:
        """Return an error with the equation and a caret below the place."""
        flat = re.sub(r"\s", " ", problem.text)
        shown, caret = _window(flat, problem.position)
        return self.error(key, f"{problem.reason}\n    {shown}\n    {' ' * caret}^", problem.hint)

    def line_of(self, key: Key) -> int | None:
        """Return the line (from 1) of a key, or of the nearest table around it that is there."""
        position = locate(self.text).nearest(_path(key))
        return None if position is None else position.line

    def unknown_key(self, prefix: Key, key: str, known: tuple[str, ...]) -> ModelError:
        """Return the error for a key that a table does not have."""
        return self.error((*_path(prefix), key), "there is no such key here", suggest(key, known))


def _path(key: Key) -> KeyPath:
    if isinstance(key, str):
        return tuple(key.split(".")) if key else ()
    return key


def _shown(path: KeyPath) -> str:
    """Join a path as one would write it; a table of an array is told by the line it stands on."""
    names = [part for part in path if isinstance(part, str)]
    return ".".join(f'"{name}"' if "." in name else name for name in names)


def _window(text: str, position: int, width: int = 90) -> tuple[str, int]:
    """Cut a long equation to the part around a position."""
    if len(text) <= width:
        return text, position
    start = max(0, min(position - width // 2, len(text) - width))
    lead = "..." if start > 0 else ""
    tail = "..." if start + width < len(text) else ""
    return f"{lead}{text[start : start + width]}{tail}", position - start + len(lead)


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


def is_name(text: str) -> bool:
    """Tell whether equations can use a name."""
    return _NAME.match(text) is not None and not keyword.iskeyword(text)


class Fields:
    """The tables of one file; every method raises `ModelError` at the key it was asked about."""

    def __init__(self, text: ModelText, data: Mapping[str, Any]) -> None:
        self.text = text
        self.data = data

    def names(self, key: str) -> tuple[str, ...]:
        """Return a list of names that equations can use, each once."""
        names = self.data.get(key, [])
        if not isinstance(names, list) or not all(isinstance(one, str) for one in names):
            raise self.text.error(
                key, f"a list of names was expected, not {names!r}", f'{key} = ["angle", "rate"]'
            )
        for name in names:
            self.check_name(key, name)
        if len(set(names)) < len(names):
            raise self.text.error(key, f"a name stands twice in {names}")
        return tuple(names)

    def check_name(self, key: Key, name: str) -> None:
        """Refuse a name that equations cannot use, or that already means something in them."""
        if not is_name(name):
            raise self.text.error(
                key,
                f"{name!r} cannot be used in equations",
                "names are letters, digits and _, and no Python keyword",
            )
        if name in RESERVED:
            raise self.text.error(
                key, f"{name!r} already means something in equations", "choose another name"
            )

    def table(self, key: str) -> dict[str, Any]:
        """Return a table; an absent one is empty."""
        table = self.data.get(key, {})
        if not isinstance(table, dict):
            raise self.text.error(
                key, f"a table was expected, not {table!r}", f"write [{key}] and one line each"
            )
        return table

    def number(self, key: Key, value: Any) -> float:
        """Return a number; infinity is one."""
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise self.text.error(key, f"a number was expected, not {value!r}")
        return float(value)

    def string(self, key: Key, value: Any) -> str:
        """Return text."""
        if not isinstance(value, str):
            raise self.text.error(key, f"text in quotes was expected, not {value!r}")
        return value

    def check_keys(self, key: Key, entry: Any, known: tuple[str, ...]) -> None:
        """Refuse what is no table, and keys it does not have."""
        if not isinstance(entry, dict):
            raise self.text.error(key, f"a table with {', '.join(known)} was expected, not {entry!r}")
        for one in entry:
            if one not in known:
                raise self.text.unknown_key(key, one, known)

    def expression(self, key: Key, text: Any) -> Expression:
        """Return a checked equation; a number is one."""
        if isinstance(text, int | float) and not isinstance(text, bool):
            text = repr(text)
        try:
            expression = Expression.of(self.string(key, text))
        except ExpressionError as problem:
            raise self.text.equation_error(key, problem) from None
        alien = {f"a model has no words such as {word!r}": at for word, at in expression.words.items()}
        alien |= {
            f"{name!r} has a letter that is not plain": at
            for name, at in expression.names.items()
            if not name.isascii()
        }
        for reason, position in alien.items():
            raise self.text.equation_error(key, ExpressionError(expression.text, reason, position))
        return expression
