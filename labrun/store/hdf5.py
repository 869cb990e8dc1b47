"""The HDF5 layout of a trial, by h5py's low-level interface: a trial costs a few ms, most of it the disk's.

Every group with a time axis has a dimension scale ``time_s``, and ``units`` on every dataset, which makes the file
valid netCDF-4. All property lists are made once; small datasets are contiguous.
"""

import errno
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Any

import numpy as np
from h5py import h5, h5a, h5d, h5ds, h5f, h5g, h5o, h5p, h5s, h5t

from labrun.devices.samples import FloatArray
from labrun.store.attributes import (
    TEXT,
    TEXT_TYPE,
    Attribute,
    read_attributes,
    storable,
    write_attribute,
    write_attributes,
)
from labrun.store.table import Variable

BLOCK = 1 << 17
"""Samples of one dataset that are handled at a time (1 MiB), and the chunk of a dataset that grows."""

_ORDER = h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED


def _access(*, in_memory: bool) -> h5p.PropFAID:
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fclose_degree(h5f.CLOSE_STRONG)  # closed means closed, whatever objects are still referred to
    if in_memory:
        access.set_fapl_core(1 << 18, False)
    return access


def _ordered(kind: Any) -> Any:
    # netCDF-4 wants groups to know the order in which their members were made.
    properties = h5p.create(kind)
    properties.set_link_creation_order(_ORDER)
    return properties


_MEMORY = _access(in_memory=True)
_ON_DISK = _access(in_memory=False)
_FILE = _ordered(h5p.FILE_CREATE)
_GROUP = _ordered(h5p.GROUP_CREATE)
_CHUNKED = h5p.create(h5p.DATASET_CREATE)
_CHUNKED.set_chunk((BLOCK,))


@dataclass(frozen=True, slots=True)
class Column:
    """One dataset along the time axis: name, unit, values of shape (n,), and further attributes."""

    name: str
    unit: str
    values: FloatArray
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Table:
    """One group: columns over a common axis, which is the first of them."""

    name: str
    columns: tuple[Column, ...]
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


def create_in_memory() -> h5f.FileID:
    """Return a new file that lives in memory until `image` gives its bytes."""
    return h5f.create(b"trial", h5f.ACC_TRUNC, _FILE, _MEMORY)


def create_on_disk(path: str) -> h5f.FileID:
    """Return a new file on disk (default library version: a newer one cannot be opened after a crash)."""
    return h5f.create(path.encode(), h5f.ACC_TRUNC, _FILE, _ON_DISK)


def open_for_reading(path: str) -> h5f.FileID:
    """Open a file; OSError where it is missing, cut short or no HDF5."""
    # The default access list: another library of this process may have the file open, and lists must agree.
    return h5f.open(path.encode(), h5f.ACC_RDONLY)


def image(file: h5f.FileID) -> bytes:
    """Return the bytes of an in-memory file."""
    h5f.flush(file)
    return bytes(file.get_file_image())


def create_group(parent: Any, name: str) -> h5g.GroupID:
    """Make a group that keeps the order of its members."""
    return h5g.create(parent, name.encode(), gcpl=_GROUP)


def join_axis(dataset: h5d.DatasetID, name: str, scale: h5d.DatasetID | None) -> h5d.DatasetID:
    """Make a dataset the scale of a new axis where there is none yet, else put it on that axis; return the scale."""
    if scale is None:
        h5ds.set_scale(dataset, name.encode())
        return dataset
    h5ds.attach_scale(dataset, scale, 0)
    return scale


def write_table(parent: Any, table: Table) -> None:
    """Write one group with its columns whole; the first column becomes the dimension scale of the others."""
    group = create_group(parent, table.name)
    write_attributes(group, table.attributes)
    scale = None
    for column in table.columns:
        values = np.ascontiguousarray(column.values, dtype=float)
        dataset = h5d.create(group, column.name.encode(), h5t.NATIVE_DOUBLE, h5s.create_simple(values.shape))
        if len(values):
            dataset.write(h5s.ALL, h5s.ALL, values)
        write_attribute(dataset, "units", column.unit)
        write_attributes(dataset, column.attributes)
        scale = join_axis(dataset, column.name, scale)


def create_growing(group: h5g.GroupID, name: str) -> h5d.DatasetID:
    """Make an empty dataset that `extend` appends to."""
    space = h5s.create_simple((0,), (h5s.UNLIMITED,))
    return h5d.create(group, name.encode(), h5t.NATIVE_DOUBLE, space, _CHUNKED)


def extend(dataset: h5d.DatasetID, values: FloatArray) -> None:
    """Append values to a growing dataset."""
    if len(values) == 0:
        return
    (length,) = dataset.shape
    dataset.set_extent((length + len(values),))
    where = dataset.get_space()
    where.select_hyperslab((length,), (len(values),))
    dataset.write(h5s.create_simple((len(values),)), where, np.ascontiguousarray(values, dtype=float))


def blocks(dataset: h5d.DatasetID) -> Iterator[FloatArray]:
    """Yield the values of a one-dimensional dataset, `BLOCK` of them at a time."""
    (length,) = dataset.shape
    if length <= BLOCK:
        yield _whole(dataset, length)
        return
    where = dataset.get_space()
    for start in range(0, length, BLOCK):
        values = np.empty(min(BLOCK, length - start))
        where.select_hyperslab((start,), (len(values),))
        dataset.read(h5s.create_simple((len(values),)), where, values)
        yield values


def _whole(dataset: h5d.DatasetID, length: int) -> FloatArray:
    values = np.empty(length)
    if length:
        dataset.read(h5s.ALL, h5s.ALL, values)
    return values


def member_names(group: Any) -> list[str]:
    """Return the names of a group's members, in the order they were made."""
    names: list[bytes] = []
    group.links.iterate(names.append, idx_type=h5.INDEX_CRT_ORDER)
    return [name.decode() for name in names]


def members(group: Any) -> list[h5d.DatasetID]:
    """Return a group's datasets, in the order they were made."""
    return [h5d.open(group, name.encode()) for name in member_names(group)]


def read_table(parent: Any, name: str) -> Table:
    """Read one group that `write_table` or a growing group made, whole."""
    group = h5g.open(parent, name.encode())
    columns = []
    for member in member_names(group):
        dataset = h5d.open(group, member.encode())
        values = _whole(dataset, *dataset.shape)
        attributes = read_attributes(dataset)
        columns.append(Column(member, str(attributes.pop("units", "")), values, attributes))
    return Table(name, tuple(columns), read_attributes(group))


def copy_table(source: Any, target: Any, name: str) -> None:
    """Copy one group into another file, in bounded memory, and tie its datasets to their axis again."""
    key = name.encode()
    h5o.copy(source, key, target, key)
    scale = None
    for dataset in members(h5g.open(target, key)):
        # HDF5 copies these object references as they are, and they point into the other file.
        if scale is None:
            if h5a.exists(dataset, b"REFERENCE_LIST"):
                h5a.delete(dataset, b"REFERENCE_LIST")
            scale = dataset
        else:
            h5a.delete(dataset, b"DIMENSION_LIST")
            h5ds.attach_scale(dataset, scale, 0)


def digest(group: Any) -> bytes:
    """Return a hash of all tables of a group: names, attributes and every sample, whatever their layout in the file.

    Reads to the last sample, so it fails where the file is damaged.
    """
    total = blake2b(digest_size=16)
    for name in sorted(member_names(group)):
        table = h5g.open(group, name.encode())
        total.update(repr((name, read_attributes(table))).encode())
        for member in member_names(table):
            dataset = h5d.open(table, member.encode())
            total.update(repr((member, dataset.shape, read_attributes(dataset))).encode())
            for values in blocks(dataset):
                total.update(values.data)
    return total.digest()


def write_variables(file: Any, axis: str, variables: Sequence[Variable]) -> None:
    """Write columns of numbers or text at the root; the first one's values become the scale `axis`."""
    scale = None
    for name, variable in [(axis, variables[0]), *((variable.name, variable) for variable in variables)]:
        values = variable.values
        kind = TEXT_TYPE if values.dtype == object else h5t.py_create(values.dtype)
        if values.dtype == object:
            values = np.array([storable(text) for text in values], dtype=TEXT)
        dataset = h5d.create(file, storable(name).encode(), kind, h5s.create_simple(values.shape))
        if len(values):
            dataset.write(h5s.ALL, h5s.ALL, values)
        write_attributes(dataset, {"units": variable.unit, "kind": variable.kind})
        scale = join_axis(dataset, name, scale)


def reserve(file: h5f.FileID, more: int) -> None:
    """Make sure that the disk has room for so many more bytes of this file.

    HDF5 cannot be closed in order once a write of it has failed, so the disk is asked before.

    Raises
    ------
    OSError
        It has no room; the file can still be closed.
    """
    os.posix_fallocate(file.get_vfd_handle(), file.get_filesize(), more)


def close(file: h5f.FileID) -> None:
    """Write everything out and close; gives back what was reserved and not needed."""
    h5f.flush(file)
    name = file.name
    file.close()
    # Its length is what tells a file cut short, and HDF5 cuts off what was reserved only when it opens it anew.
    h5f.open(name, h5f.ACC_RDWR, _ON_DISK).close()


@contextmanager
def flush_errors() -> Iterator[None]:
    """Turn the RuntimeError of a cache that cannot be flushed into the OSError it comes from."""
    try:
        yield
    except RuntimeError as error:
        code = re.search(r"errno = (\d+)", str(error))
        raise OSError(int(code[1]) if code else errno.EIO, str(error)) from error
