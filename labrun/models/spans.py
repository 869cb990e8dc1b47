"""Where each value of a TOML text stands, from the syntax tree; `tomllib` reads values and keeps no places."""

from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tree_sitter import Node

KeyPath = tuple[str | int, ...]
"""Keys from the top of the file down; an integer counts the tables of an array."""


@dataclass(slots=True)
class Spans:
    """Places in one text.

    Attributes
    ----------
    lines : path -> line, from 1
        Of every key and table header.
    values : path -> (begin, end)
        Bytes of every value, in the text encoded as UTF-8.
    """

    lines: dict[KeyPath, int] = field(default_factory=dict)
    values: dict[KeyPath, tuple[int, int]] = field(default_factory=dict)

    def line(self, path: KeyPath) -> int | None:
        """Return the line of a key; of the nearest table around it that is there, if the key itself is not."""
        while path:
            if path in self.lines:
                return self.lines[path]
            path = path[:-1]
        return None


def spans(text: str) -> Spans:
    """Return the places of a TOML text, inline tables and arrays of tables included."""
    import tree_sitter_toml
    from tree_sitter import Language, Parser

    tree = Parser(Language(tree_sitter_toml.language())).parse(text.encode())
    return _Walk().document(tree.root_node)


class _Walk:
    """One pass over the syntax tree."""

    def __init__(self) -> None:
        self._found = Spans()
        self._tables: defaultdict[KeyPath, int] = defaultdict(int)

    def document(self, root: "Node") -> Spans:
        for node in root.named_children:
            if node.type == "pair":
                self._pair(node, ())
            elif node.type in ("table", "table_array_element"):
                self._table(node)
        return self._found

    def _table(self, node: "Node") -> None:
        head, *body = [child for child in node.named_children if child.type != "comment"]
        path: KeyPath = ()
        for part in _parts(head):
            path = (*path, self._tables[path] - 1, part) if path in self._tables else (*path, part)
        if node.type == "table_array_element":
            self._tables[path] += 1
            path = (*path, self._tables[path] - 1)
        elif path in self._tables:
            path = (*path, self._tables[path] - 1)
        self._found.lines.setdefault(path, head.start_point[0] + 1)
        for child in body:
            if child.type == "pair":
                self._pair(child, path)

    def _pair(self, node: "Node", path: KeyPath) -> None:
        named = [child for child in node.named_children if child.type != "comment"]
        if len(named) != 2:
            return
        key, value = named
        for part in _parts(key):
            path = (*path, part)
            self._found.lines.setdefault(path, key.start_point[0] + 1)
        self._value(value, path)

    def _value(self, node: "Node", path: KeyPath) -> None:
        self._found.values[path] = (node.start_byte, node.end_byte)
        if node.type == "inline_table":
            for child in node.named_children:
                if child.type == "pair":
                    self._pair(child, path)
        elif node.type == "array":
            for index, child in enumerate(one for one in node.named_children if one.type != "comment"):
                self._found.lines[(*path, index)] = child.start_point[0] + 1
                self._value(child, (*path, index))


def _parts(node: "Node") -> list[str]:
    """Return the parts of a bare, quoted or dotted key."""
    import tomllib

    parts = []
    table = tomllib.loads(f"{(node.text or b'').decode()} = 0")
    while isinstance(table, dict):
        (key,) = table
        parts.append(key)
        table = table[key]
    return parts
