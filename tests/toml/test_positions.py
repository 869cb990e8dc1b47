"""Where keys stand in a TOML text."""

import tomllib

import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.toml import Position, locate

TEXT = """\
a = 1
b.c = { x = [1, { y = 2 }], "q.r" = 3 }  # a comment
[t."u v"]
k = [
    1,   # first
    { z = 2 },
]
[[rows]]
v = 1
[[rows]]
v = 2
[rows.sub]
w = "µ"
x = { ü = 1, after = 2 }
"""


def test_inline_tables_arrays_of_tables_dotted_and_quoted_keys_are_all_found():
    keys = locate(TEXT).keys
    assert keys["a",] == Position(1, 1)
    assert keys["b",] == Position(2, 1)
    assert keys["b", "c"] == Position(2, 3)
    assert keys["b", "c", "x", 1, "y"] == Position(2, 19)
    assert keys["b", "c", "q.r"] == Position(2, 29)
    assert keys["t", "u v", "k"] == Position(4, 1)
    assert keys["t", "u v", "k", 1, "z"] == Position(6, 7)
    assert keys["rows", 0, "v"] == Position(9, 1)
    assert keys["rows", 1, "v"] == Position(11, 1)
    assert keys["rows", 1, "sub", "w"] == Position(13, 1)


def test_columns_count_characters_not_bytes():
    assert locate('x = { "ü" = 1, after = 2 }').keys["x", "after"] == Position(1, 16)


def test_a_value_stands_after_its_key():
    assert locate(TEXT).of_value(("b", "c", "x", 0)) == Position(2, 14)


def test_what_is_not_there_is_where_its_table_is():
    assert locate(TEXT).of_key(("t", "u v", "missing", "deeper")) == Position(3, 2)


_KEYS = st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), min_size=1, max_size=5)
_TREES = st.dictionaries(
    _KEYS,
    st.recursive(
        st.integers(0, 9) | st.text(max_size=3),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_KEYS, inner, max_size=3),
        max_leaves=8,
    ),
    max_size=4,
)


def _paths(value, path=()):
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*path, key)
        yield from _paths(inner, (*path, key))


@settings(max_examples=30)
@given(_TREES)
def test_every_key_that_tomllib_reads_has_a_place(tree):
    text = tomli_w.dumps(tree)
    positions = locate(text)
    lines = text.split("\n")
    for path in _paths(tomllib.loads(text)):
        position = positions.keys[path]
        assert 1 <= position.column <= len(lines[position.line - 1]) + 1


@settings(max_examples=30)
@given(_TREES)
def test_the_bytes_of_every_value_read_as_that_value(tree):
    text = tomli_w.dumps(tree)
    spans = locate(text).spans
    for path in _paths(tomllib.loads(text)):
        if path not in spans:  # a table with a header of its own
            continue
        begin, end = spans[path]
        assert tomllib.loads(f"value = {text.encode()[begin:end].decode()}")["value"] == _at(tree, path)


def _at(tree, path):
    for part in path:
        tree = tree[part]
    return tree
