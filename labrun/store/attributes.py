"""Attributes and texts of HDF5 objects, by h5py's low-level interface: these are most of what a small file costs."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5s, h5t

Attribute = str | int | float
TEXT = h5py.string_dtype()
"""Text of any length, in memory; `TEXT_TYPE` in the file."""
TEXT_TYPE = h5t.py_create(TEXT, logical=True)

_SCALE_ATTRIBUTES = frozenset({b"CLASS", b"NAME", b"DIMENSION_LIST", b"REFERENCE_LIST", b"_Netcdf4Dimid"})
MAX_FIXED = 60_000
"""Bytes: an attribute in an object header stays below 64 KiB; longer text goes to the file's heap."""
_SCALAR = h5s.create(h5s.SCALAR)


@lru_cache(maxsize=4096)
def _text(size: int) -> h5t.TypeID:
    kind = h5t.C_S1.copy()
    kind.set_size(size)
    kind.set_strpad(h5t.STR_NULLPAD)
    kind.set_cset(h5t.CSET_UTF8)
    return kind


def storable(text: str) -> str:
    """Return text as HDF5 can hold it: a zero byte, or half a character, from a garbled answer is made visible."""
    return text.replace("\0", "\N{SYMBOL FOR NULL}").encode("utf-8", "replace").decode()


def write_attribute(owner: Any, name: str, value: Attribute) -> None:
    """Write one attribute: text (see `storable`), whole number or float."""
    key = storable(name).encode()
    if isinstance(value, str):
        data = storable(value).encode()
        if len(data) > MAX_FIXED:
            h5a.create(owner, key, TEXT_TYPE, _SCALAR).write(np.array(data.decode(), dtype=TEXT))
            return
        kind = _text(max(len(data), 1))
        h5a.create(owner, key, kind, _SCALAR).write(np.array(data, dtype=f"S{max(len(data), 1)}"), kind)
    elif isinstance(value, (int, np.integer)):
        h5a.create(owner, key, h5t.NATIVE_INT64, _SCALAR).write(
            np.array(value, dtype=np.int64), h5t.NATIVE_INT64
        )
    else:
        h5a.create(owner, key, h5t.NATIVE_DOUBLE, _SCALAR).write(
            np.array(value, dtype=float), h5t.NATIVE_DOUBLE
        )


def rewrite_attribute(owner: Any, name: str, value: Attribute) -> None:
    """Give an attribute that `write_attribute` made another value of the same type; text of the same length."""
    attribute = h5a.open(owner, storable(name).encode())
    if isinstance(value, str):
        data = storable(value).encode()
        attribute.write(np.array(data, dtype=f"S{len(data)}"), _text(len(data)))
    elif isinstance(value, (int, np.integer)):
        attribute.write(np.array(value, dtype=np.int64), h5t.NATIVE_INT64)
    else:
        attribute.write(np.array(value, dtype=float), h5t.NATIVE_DOUBLE)


def write_attributes(owner: Any, attributes: Mapping[str, Attribute]) -> None:
    """Write attributes in their order."""
    for name, value in attributes.items():
        write_attribute(owner, name, value)


def read_attribute(owner: Any, name: str) -> Attribute:
    """Read one attribute; KeyError if there is none of that name."""
    return _value(h5a.open(owner, name.encode()))


def read_attributes(owner: Any) -> dict[str, Attribute]:
    """Read all attributes but the book-keeping of dimension scales, by name."""
    found = {}
    for position in range(h5a.get_num_attrs(owner)):
        attribute = h5a.open(owner, index=position)
        if attribute.name not in _SCALE_ATTRIBUTES:
            found[attribute.name.decode()] = _value(attribute)
    return found


def read_unit(dataset: Any) -> str:
    """Return the attribute ``units``: much faster than all attributes; KeyError if there is none."""
    attribute = h5a.open(dataset, b"units")
    size = attribute.get_storage_size()
    raw = np.empty((), dtype=f"S{size}")
    attribute.read(raw, _text(size))
    return bytes(raw[()]).decode()


def read_number(owner: Any, name: str) -> float | None:
    """Return an attribute that is a float; None if there is none."""
    if not h5a.exists(owner, name.encode()):
        return None
    number = np.empty(())
    h5a.open(owner, name.encode()).read(number, h5t.NATIVE_DOUBLE)
    return float(number)


def _value(attribute: h5a.AttrID) -> Attribute:
    kind = attribute.get_type()
    if isinstance(kind, h5t.TypeStringID):
        if kind.is_variable_str():
            values = np.empty((), dtype=TEXT)
            attribute.read(values)
            return _decoded(values.item())
        raw = np.empty((), dtype=f"S{kind.get_size()}")
        attribute.read(raw, mtype=kind)
        return bytes(raw[()]).decode()
    number = np.empty((), dtype=np.int64 if isinstance(kind, h5t.TypeIntegerID) else np.float64)
    attribute.read(number)
    value: Attribute = number.item()
    return value


def write_text(group: Any, name: str, text: str) -> None:
    """Write a text of any length as a dataset of its own."""
    dataset = h5d.create(group, name.encode(), TEXT_TYPE, _SCALAR)
    dataset.write(h5s.ALL, h5s.ALL, np.array(text, dtype=TEXT))


def read_text(group: Any, name: str) -> str:
    """Read what `write_text` wrote."""
    dataset = h5d.open(group, name.encode())
    values = np.empty((), dtype=TEXT)
    dataset.read(h5s.ALL, h5s.ALL, values)
    return _decoded(values.item())


def _decoded(text: str | bytes) -> str:
    return text.decode() if isinstance(text, bytes) else text
