"""Where in a TOML text each key and each value stands: by path, line and column, and the bytes of values.

`tomllib` reads the values and keeps no positions; the syntax tree of tree-sitter gives them.
"""

import tomllib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import tree_sitter_toml
from tree_sitter import Language, Node, Parser

KeyPath = tuple[str | int, ...]
"""Keys from the top of the file down; an integer is a position in a list."""


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
    found = locate(text).spans
    encoded = text.encode()
    places = {found[path]: value for path, value in values.items()}
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
