"""What is wrong with an experiment file: one line a problem, all of a file at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from labrun.errors import SpecError
from labrun.toml_positions import KeyPath


@dataclass(frozen=True, slots=True)
class Problem:
    """Something wrong at one key, before it is known where in the file that key stands.

    Attributes
    ----------
    path
        The key.
    message
        What was expected, with bound and unit.
    at_value
        Point at the value instead of at the key.
    """

    path: KeyPath
    message: str
    at_value: bool = False


@dataclass(frozen=True, slots=True)
class LocatedProblem:
    """A problem with its place: `origin` is "file:line:column", or the override that brought the key."""

    origin: str
    line: int | None
    column: int | None
    key: str
    value: Any
    message: str

    def __str__(self) -> str:
        key = self.key + ("" if self.value is None else f" = {shown(self.value)}")
        return ": ".join(part for part in (self.origin, key, self.message) if part)

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name, for scripts."""
        return {name: getattr(self, name) for name in self.__slots__}


class SpecFileError(SpecError):
    """Everything that is wrong with one experiment file.

    Parameters
    ----------
    name
        The file.
    problems
        In the order of their lines.
    """

    def __init__(self, name: str, problems: Sequence[LocatedProblem], *, hint: str | None = None) -> None:
        self.problems = tuple(problems)
        lines = [str(problem) for problem in problems]
        if len(lines) > 1:
            lines.insert(0, f"{name}: {len(problems)} errors")
        super().__init__("\n".join(lines), hint=hint)
        self.details["problems"] = [problem.to_json() for problem in self.problems]


def dotted(path: KeyPath) -> str:
    """Return a path as people write it: ``run.conditions[0].release_deg``."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            bare = part.replace("_", "").replace("-", "").isalnum() and part.isascii()
            text += ("." if text else "") + (part if bare else f'"{part}"')
    return text


def shown(value: object) -> str:
    """Return a value as it would stand in the file, shortened."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        text = f'"{value}"'
    elif isinstance(value, dict):
        text = "{ " + ", ".join(f"{key} = {shown(item)}" for key, item in value.items()) + " }"
    elif isinstance(value, list | tuple):
        text = "[" + ", ".join(shown(item) for item in value) + "]"
    else:
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
