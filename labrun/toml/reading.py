"""From a TOML file of ours to a checked value, or to everything that is wrong with it."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from labrun.errors import RequestError
from labrun.toml.faults import Fault, KeyPath, LocatedFault, dotted, locate, refusal
from labrun.toml.names import nearest
from labrun.toml.validation import Model, validate


def read(path: Path, model: type[Model], *, kind: type[RequestError] = RequestError) -> Model:
    """Read a file as a pydantic model.

    Raises
    ------
    RequestError
        Of the class `kind`: the file cannot be read, or all that is wrong with it, each fault with file, line, key,
        what was found and what would do.
    """
    text = text_of(path, kind=kind)
    data = parsed(text, str(path), kind=kind)
    value, faults = validate(model, data)
    if value is None or faults:
        raise refusal(kind, str(path), Places(str(path), text, data).of_all(faults))
    return value


def text_of(path: Path, *, kind: type[RequestError] = RequestError, what: str = "file") -> str:
    """Return the text of a file; the error says `what` it is."""
    try:
        return path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
    except OSError as error:
        raise kind(f"{what} {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise kind(f"{what} {path} is not text in UTF-8 (byte {error.start})") from error


def parsed(text: str, name: str, *, kind: type[RequestError] = RequestError) -> dict[str, Any]:
    """Return a text's tables; the error names the file, line and column."""
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise refusal(kind, name, [LocatedFault(name, None, None, "", None, "nested too deeply")]) from error
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        place = re.search(r" \(at line (\d+), column (\d+)\)$", message)
        if place is not None:
            line, column = int(place[1]), int(place[2])
            message = message[: place.start()]
        else:  # at the end of the text
            line, column = text.count("\n") + 1, len(text.rpartition("\n")[2]) + 1
            message = re.sub(r" \(at end of document\)$", " at the end of the file", message)
        fault = LocatedFault(f"{name}:{line}:{column}", line, column, "", None, f"not valid TOML: {message}")
        raise refusal(kind, name, [fault]) from error


_ABSENT = object()


class Places:
    """Finds the place of each fault: a line of the file, or the override that brought the key.

    Parameters
    ----------
    name
        The file's, for messages.
    text
        Its content.
    data
        What it says, overrides included.
    origins
        The keys that overrides have set, and the override each came from.
    """

    def __init__(
        self, name: str, text: str, data: Mapping[str, Any], origins: Mapping[KeyPath, str] | None = None
    ) -> None:
        self._name = name
        self._positions = locate(text)
        self._data = data
        self._origins = origins or {}

    def of_all(self, faults: Sequence[Fault]) -> list[LocatedFault]:
        """Return the faults with their places, each once, in the order of their lines."""
        located = [self._of(fault) for fault in dict.fromkeys(faults)]
        return sorted(located, key=lambda item: (item.line is not None, item.line or 0, item.column or 0))

    def _of(self, fault: Fault) -> LocatedFault:
        value = self.value(fault.path)
        message = fault.message
        shown = None if value is _ABSENT or isinstance(value, dict) else value
        for path, override in self._origins.items():
            if path[: len(fault.path)] == fault.path or fault.path[: len(path)] == path:
                in_file = fault.path in self._positions.keys and len(fault.path) < len(path)
                if not in_file:
                    if "did you mean" not in message:
                        message += self._misspelt_table(fault.path)
                    return LocatedFault(override, None, None, dotted(fault.path), shown, message)
        place = self._positions.of_value if fault.at_value else self._positions.of_key
        position = place(fault.path)
        origin = f"{self._name}:{position.line}:{position.column}"
        return LocatedFault(origin, position.line, position.column, dotted(fault.path), shown, message)

    def _misspelt_table(self, path: KeyPath) -> str:
        """Return a suggestion where an override made a table because the name of the one it meant was misspelt."""
        value, parent = self.value(path), self.value(path[:-1])
        if not isinstance(value, dict) or not isinstance(parent, dict) or not path:
            return ""
        near = nearest(str(path[-1]), [key for key in parent if key != path[-1]])
        return f'; did you mean "{dotted((*path[:-1], near))}"?' if near is not None else ""

    def value(self, path: KeyPath) -> Any:
        """Return what stands at a key; an object that is nothing else if the key is absent."""
        value: Any = self._data
        for part in path:
            try:
                value = value[part]
            except (KeyError, IndexError, TypeError):
                return _ABSENT
        return value
