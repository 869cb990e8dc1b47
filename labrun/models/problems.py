"""Where in a model file a fault is, for the person who wrote it."""

import re
from dataclasses import dataclass

from labrun.errors import ModelError
from labrun.models.expression import ExpressionError, nearest

_HEADER = re.compile(r"^\s*\[+\s*([A-Za-z0-9_.\- ]+?)\s*\]+")


@dataclass(frozen=True)
class ModelText:
    """The text of a model file and the name it is reported by."""

    name: str
    text: str

    def error(self, key: str, message: str, hint: str | None = None) -> ModelError:
        """Return an error at a key such as ``"equations.rate"``."""
        line = self.line_of(key)
        where = self.name if line is None else f"{self.name}:{line}"
        return ModelError(f"{where}: {key}: {message}" if key else f"{where}: {message}", hint=hint or None)

    def equation_error(self, key: str, equation: str, problem: ExpressionError) -> ModelError:
        """Return an error with the equation and a caret below the place."""
        flat = re.sub(r"\s", " ", equation)
        shown, caret = _window(flat, problem.position)
        return self.error(key, f"{problem}\n    {shown}\n    {' ' * caret}^", problem.hint)

    def line_of(self, key: str) -> int | None:
        """Return the line (from 1) a key stands on, or None for a file laid out in an unusual way."""
        if not key:
            return None
        wanted = key.split(".")
        section: list[str] = []
        for number, line in enumerate(self.text.splitlines(), start=1):
            header = _HEADER.match(line)
            if header is not None:
                section = [part.strip() for part in header.group(1).split(".")]
                if section == wanted:
                    return number
                continue
            assigned = re.match(r"^\s*([A-Za-z0-9_.\-\"]+)\s*=", line)
            if assigned is not None:
                path = [*section, *assigned.group(1).replace('"', "").split(".")]
                if path == wanted[: len(path)] and path:
                    return number
        return None

    def unknown_key(self, prefix: str, key: str, known: tuple[str, ...]) -> ModelError:
        """Return the error for a key that a table does not have."""
        path = f"{prefix}.{key}" if prefix else key
        return self.error(path, "there is no such key here", nearest(key, known))


def _window(text: str, position: int, width: int = 90) -> tuple[str, int]:
    """Cut a long equation to the part around a position."""
    if len(text) <= width:
        return text, position
    start = max(0, min(position - width // 2, len(text) - width))
    lead = "..." if start > 0 else ""
    tail = "..." if start + width < len(text) else ""
    return f"{lead}{text[start : start + width]}{tail}", position - start + len(lead)
