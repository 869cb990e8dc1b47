"""What is wrong with a TOML file, one line a fault, all of a file at once; and where each key and value of it stands.

`tomllib` reads the values and keeps no positions; the syntax tree of tree-sitter gives them.
"""

import tomllib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any

import tree_sitter_toml
from pydantic_core import PydanticCustomError
from tree_sitter import Language, Node, Parser

from labrun.errors import RequestError

KeyPath = tuple[str | int, ...]
"""Keys from the top of the file down; an integer is a position in a list."""


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


def refusal(kind: type[RequestError], name: str, faults: Sequence[LocatedFault]) -> RequestError:
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
    error = kind("\n".join(lines))
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


@dataclass(frozen=True, slots=True)
class Position:
    """Line and column of a character, both counted from 1."""

    line: int
    column: int


@dataclass(slots=True)
class Positions:
    """Positions of the keys and of the values of one file.

    Attributes
    ----------
    keys, values
        Where each begins; of a table, its header.
    spans : path -> (begin, end)
        Bytes of every value, in the text encoded as UTF-8.
    """

    keys: dict[KeyPath, Position] = field(default_factory=dict)
    values: dict[KeyPath, Position] = field(default_factory=dict)
    spans: dict[KeyPath, tuple[int, int]] = field(default_factory=dict)

    def nearest(self, path: KeyPath) -> Position | None:
        """Return where a key stands; where its nearest enclosing table does, if the key is absent; None if none is."""
        while path:
            if path in self.keys:
                return self.keys[path]
            path = path[:-1]
        return None

    def of_key(self, path: KeyPath) -> Position:
        """Return where a key, or its nearest enclosing table, stands; the beginning of the file if none is there."""
        return self.nearest(path) or Position(1, 1)

    def of_value(self, path: KeyPath) -> Position:
        """Return where a key's value stands; falls back as `of_key` does."""
        return self.values.get(path) or self.of_key(path)


def locate(text: str) -> Positions:
    """Return the positions of every key and value of a TOML text, inline tables and arrays of tables included."""
    tree = Parser(Language(tree_sitter_toml.language())).parse(text.encode())
    return _Walk(text).document(tree.root_node)


def replaced(text: str, values: Mapping[KeyPath, str]) -> str:
    """Return a text with other values, as TOML writes them, where those of these paths stand; all else as it was.

    Raises
    ------
    KeyError
        A path that the text does not have.
    """
    spans = locate(text).spans
    encoded = text.encode()
    places = {spans[path]: value for path, value in values.items()}
    for (begin, end), value in sorted(places.items(), reverse=True):
        encoded = encoded[:begin] + value.encode() + encoded[end:]
    return encoded.decode()


class _Walk:
    """One pass over the syntax tree."""

    def __init__(self, text: str) -> None:
        self._lines = text.encode().split(b"\n")
        self._found = Positions()
        self._elements: defaultdict[KeyPath, int] = defaultdict(int)

    def document(self, root: Node) -> Positions:
        for node in root.named_children:
            if node.type == "pair":
                self._pair(node, ())
            elif node.type in ("table", "table_array_element"):
                self._table(node)
        return self._found

    def _position(self, node: Node) -> Position:
        row, column = node.start_point
        # Columns of the tree count bytes; people count characters.
        return Position(row + 1, len(self._lines[row][:column].decode(errors="replace")) + 1)

    def _table(self, node: Node) -> None:
        head, *body = [child for child in node.named_children if child.type != "comment"]
        path = self._key(head, (), follow_arrays=True)
        if node.type == "table_array_element":
            index = self._elements[path]
            self._elements[path] += 1
            path = (*path, index)
        self._found.keys[path] = self._position(head)
        for child in body:
            if child.type == "pair":
                self._pair(child, path)

    def _key(self, node: Node, path: KeyPath, *, follow_arrays: bool = False) -> KeyPath:
        """Extend `path` by a bare, quoted or dotted key, noting where each part stands."""
        if node.type == "dotted_key":
            for child in node.named_children:
                path = self._key(child, path, follow_arrays=follow_arrays)
            return path
        raw = (node.text or b"").decode()
        if follow_arrays and path in self._elements:
            path = (*path, self._elements[path] - 1)
        path = (*path, _unquoted(raw) if node.type == "quoted_key" else raw)
        self._found.keys.setdefault(path, self._position(node))
        return path

    def _pair(self, node: Node, path: KeyPath) -> None:
        named = [child for child in node.named_children if child.type != "comment"]
        if len(named) == 2:
            self._value(named[1], self._key(named[0], path))

    def _value(self, node: Node, path: KeyPath) -> None:
        self._found.values[path] = self._position(node)
        self._found.spans[path] = (node.start_byte, node.end_byte)
        if node.type == "inline_table":
            for child in node.named_children:
                if child.type == "pair":
                    self._pair(child, path)
        elif node.type == "array":
            elements = [child for child in node.named_children if child.type != "comment"]
            for index, child in enumerate(elements):
                self._found.keys[(*path, index)] = self._position(child)
                self._value(child, (*path, index))


def _unquoted(raw: str) -> str:
    return next(iter(tomllib.loads(f"{raw} = 0")))
