"""Tables in HDF5, by h5py's low-level interface: a trial costs a few ms, most of it the disk's.

Every group with a time axis has a dimension scale ``time_s``, and ``units`` on every dataset, which makes the file
valid netCDF-4. All property lists are made once; small datasets are contiguous.
"""

import errno
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Any

import numpy as np
from h5py import h5, h5d, h5ds, h5f, h5g, h5o, h5p, h5s, h5t
from numpy.typing import DTypeLike, NDArray

from labrun.devices.samples import FloatArray
from labrun.store.attributes import (
    TEXT,
    TEXT_TYPE,
    Attribute,
    read_attributes,
    read_number,
    read_unit,
    storable,
    write_attribute,
    write_attributes,
)
from labrun.store.blocks import BLOCK, ReadAhead, extent

TARE = "tare"
"""The one attribute of a column beside its unit: the offset found before the recording."""

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
    properties.set_obj_track_times(False)  # the same content gives the same bytes
    return properties


_MEMORY = _access(in_memory=True)
_ON_DISK = _access(in_memory=False)
_FILE = _ordered(h5p.FILE_CREATE)
_GROUP = _ordered(h5p.GROUP_CREATE)
_PLAIN = h5p.create(h5p.DATASET_CREATE)
_PLAIN.set_obj_track_times(False)
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


def open_image(content: bytes) -> h5f.FileID:
    """Open a copy, in memory, of a file's bytes, to change it and take its `image`."""
    access = _access(in_memory=True)
    access.set_file_image(content)
    return h5f.open(b"trial", h5f.ACC_RDWR, access)


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


def write_table(parent: Any, table: Table) -> list[h5d.DatasetID]:
    """Write one group with its columns whole; the first column becomes the dimension scale of the others.

    Returns
    -------
    list
        The dataset of each column.
    """
    group = create_group(parent, table.name)
    write_attributes(group, table.attributes)
    scale = None
    datasets = []
    for column in table.columns:
        values = np.ascontiguousarray(column.values, dtype=float)
        space = h5s.create_simple(values.shape)
        dataset = h5d.create(group, column.name.encode(), h5t.NATIVE_DOUBLE, space, _PLAIN)
        if len(values):
            dataset.write(h5s.ALL, h5s.ALL, values)
        write_attribute(dataset, "units", column.unit)
        write_attributes(dataset, column.attributes)
        scale = join_axis(dataset, column.name, scale)
        datasets.append(dataset)
    return datasets


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
    dataset.write(extent(len(values)), where, np.ascontiguousarray(values, dtype=float))


def write_at(dataset: h5d.DatasetID, first: int, values: NDArray[Any]) -> None:
    """Write values to a part of a dataset."""
    if len(values):
        where = dataset.get_space()
        where.select_hyperslab((first,), (len(values),))
        dataset.write(extent(len(values)), where, values)


def member_names(group: Any) -> list[str]:
    """Return the names of a group's members, in the order they were made."""
    names: list[bytes] = []
    group.links.iterate(names.append, idx_type=h5.INDEX_CRT_ORDER)
    return [name.decode() for name in names]


def group_names(file: Any) -> list[str]:
    """Return the names of the groups among a group's members, in the order they were made."""
    return [name for name in member_names(file) if h5o.get_info(file, name.encode()).type == h5o.TYPE_GROUP]


@dataclass(frozen=True, slots=True)
class StoredColumn:
    """One column of a trial as it lies in a file: `count` values of a dataset from `first` on."""

    name: str
    unit: str
    attributes: Mapping[str, Attribute]
    values: ReadAhead
    first: int
    count: int

    def blocks(self) -> Iterator[FloatArray]:
        """Yield the values, `BLOCK` of them at a time."""
        return self.values.blocks(self.first, self.count)

    def last(self, count: int) -> FloatArray:
        """Return the last so many values, without reading the others."""
        return _joined(list(self.values.blocks(self.first + self.count - count, count)))


@dataclass(frozen=True, slots=True)
class HeldColumn:
    """One column of a trial whose file is in memory."""

    name: str
    unit: str
    attributes: Mapping[str, Attribute]
    values: FloatArray

    @property
    def count(self) -> int:
        """Number of samples."""
        return len(self.values)

    def blocks(self) -> Iterator[FloatArray]:
        """Yield the values, all at once."""
        yield self.values

    def last(self, count: int) -> FloatArray:
        """Return the last so many values."""
        return self.values[len(self.values) - count :]


AnyColumn = StoredColumn | HeldColumn


@dataclass(frozen=True, slots=True)
class StoredTable:
    """One table of a trial as it lies in a file; its samples are read when asked for."""

    name: str
    columns: tuple[AnyColumn, ...]
    attributes: Mapping[str, Attribute]

    @property
    def count(self) -> int:
        """Number of samples."""
        return self.columns[0].count if self.columns else 0

    def read(self) -> Table:
        """Read it whole."""
        columns = [
            Column(column.name, column.unit, _joined(list(column.blocks())), column.attributes)
            for column in self.columns
        ]
        return Table(self.name, tuple(columns), self.attributes)

    def copy(self, append: "Append | None" = None) -> bytes:
        """Read to the last sample, hand on every block, and return a hash of names, units, attributes and samples.

        An attribute that is NaN counts as one that is missing. Fails where the file is damaged.

        Parameters
        ----------
        append
            Called with a column and its next block.
        """
        total = blake2b(repr((self.name, _numbers(self.attributes), self.count)).encode(), digest_size=16)
        for column in self.columns:
            total.update(repr((column.name, column.unit, _numbers(column.attributes))).encode())
            for values in column.blocks():
                total.update(values.data)
                if append is not None:
                    append(column, values)
        return total.digest()


Append = Callable[[AnyColumn, FloatArray], None]


def _numbers(attributes: Mapping[str, Attribute]) -> list[tuple[str, Attribute]]:
    return sorted((name, value) for name, value in attributes.items() if value == value)  # noqa: PLR0124 - NaN


def _joined(parts: list[FloatArray]) -> FloatArray:
    """Return the parts as one array that is nobody else's."""
    if len(parts) == 1:
        return parts[0] if parts[0].base is None else parts[0].copy()
    return np.concatenate([np.empty(0), *parts])


def open_table(parent: Any, name: str) -> StoredTable:
    """Open one group that `write_table` or a growing group made."""
    group = h5g.open(parent, name.encode())
    columns = []
    for member in member_names(group):
        dataset = h5d.open(group, member.encode())
        tare = read_number(dataset, TARE)
        attributes = {} if tare is None else {TARE: tare}
        columns.append(
            StoredColumn(member, read_unit(dataset), attributes, ReadAhead(dataset), 0, *dataset.shape)
        )
    return StoredTable(name, tuple(columns), read_attributes(group))


def read_table(parent: Any, name: str) -> Table:
    """Read one group whole."""
    return open_table(parent, name).read()


def write_array(group: Any, name: str, values: NDArray[Any]) -> h5d.DatasetID:
    """Write numbers, or text where the array is of objects, as one dataset."""
    text = values.dtype == object
    kind = TEXT_TYPE if text else h5t.py_create(values.dtype)
    if text:
        values = np.array([storable(word) for word in values], dtype=TEXT)
    dataset = h5d.create(group, storable(name).encode(), kind, h5s.create_simple(values.shape))
    if len(values):
        dataset.write(h5s.ALL, h5s.ALL, values)
    return dataset


def read_array(group: Any, name: str, kind: DTypeLike) -> NDArray[Any]:
    """Read the numbers of one dataset whole."""
    dataset = h5d.open(group, name.encode())
    values = np.empty(dataset.shape, dtype=kind)
    if len(values):
        dataset.read(h5s.ALL, h5s.ALL, values)
    return values


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
