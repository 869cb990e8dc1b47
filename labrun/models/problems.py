"""Where in a model file a fault is, for the person who wrote it."""

import re
from dataclasses import dataclass

from labrun.errors import ModelError
from labrun.toml import ExpressionError, KeyPath, locate, suggest

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
