"""What is wrong with a TOML file: one line a fault, all of a file at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from pydantic_core import PydanticCustomError

from labrun.errors import RequestError
from labrun.toml.positions import KeyPath


@dataclass(frozen=True, slots=True)
class Fault:
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
class LocatedFault:
    """A fault with its place: `origin` is "file:line:column", or the override that brought the key."""

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


def refusal(
    kind: type[RequestError], name: str, faults: Sequence[LocatedFault], *, hint: str | None = None
) -> RequestError:
    """Return the error that tells everything that is wrong with one file.

    Parameters
    ----------
    kind
        The class of the error.
    name
        The file.
    faults
        In the order of their lines; ``details["problems"]`` has them for scripts.
    """
    lines = [str(fault) for fault in faults]
    if len(lines) > 1:
        lines.insert(0, f"{name}: {len(faults)} errors")
    error = kind("\n".join(lines), hint=hint)
    error.details["problems"] = [fault.to_json() for fault in faults]
    return error


class TableFaults:
    """Faults of a table that show only when several of its keys are seen together.

    Collects them inside a pydantic validator, and raises them together when the block ends.
    """

    def __init__(self) -> None:
        self._found: list[tuple[tuple[str, ...], str, tuple[str, ...] | None]] = []

    def add(
        self, key: str | tuple[str, ...] | None, message: str, *, of: tuple[str, ...] | None = None
    ) -> None:
        """Note a fault at a key of the table (None: at the table itself).

        `of` are the keys that the rule looks at: once one of them has been refused, the rule says nothing new. None
        stands for all keys of the table.
        """
        path = () if key is None else (key,) if isinstance(key, str) else key
        self._found.append((path, message, of))

    def __enter__(self) -> "TableFaults":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None and self._found:
            text = "; ".join(
                ".".join([*path, ""])[:-1] + (": " if path else "") + message
                for path, message, _ in self._found
            )
            raise PydanticCustomError("faults", "{text}", {"text": text, "faults": list(self._found)})


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
