"""One device's samples of all trials in one group: a contiguous ragged array of the CF conventions.

Over the dimension ``sample`` stand the columns of all trials one after the other, and ``trial_index``; over the root's
dimension ``trial`` stand ``first_sample``, ``sample_count`` and what else is known of each trial. A trial without the
device has ``sample_count`` 0; a channel that one trial lacks is NaN there, and ``column_set`` tells which columns
each trial really has. The trial's index cannot be called ``trial``: beside variables over the dimension of that name
xarray takes it for their coordinate.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from h5py import h5d, h5ds, h5g, h5p, h5s, h5t
from numpy.typing import NDArray

from labrun.devices.samples import FloatArray
from labrun.store import hdf5
from labrun.store.attributes import TEXT, Attribute, read_attributes, write_attribute, write_attributes
from labrun.store.blocks import BLOCK, ReadAhead, blocks
from labrun.store.hdf5 import AnyColumn, StoredColumn, StoredTable

SAMPLE = "sample"
TRIAL_INDEX = "trial_index"
FIRST = "first_sample"
COUNT = "sample_count"
SET = "column_set"
KINDS: Mapping[str, type] = {
    "rate_hz": float,
    "lost": int,
    "saturated": int,
    "clock_glitches": int,
    "period_s": float,
    "reason": str,
}
"""Attributes that a table of a trial may have."""
_TARE = "tare_"
_TAKEN = frozenset({SAMPLE, TRIAL_INDEX, FIRST, COUNT, SET, *KINDS})
_UNITS = {"rate_hz": "Hz", "period_s": "s"}
_DIMENSION = "This is a netCDF dimension but not a netCDF variable. %9d"
"""How netCDF-4 marks a dimension scale that stands only for a dimension."""
CHUNK = 1 << 14
"""Samples of a chunk (128 KiB) of a dataset too large for one block."""


class Growing:
    """One dataset over ``sample`` while it grows; what is small stays contiguous, what is large is chunked.

    Parameters
    ----------
    group
        Where it will stand.
    name
        Its name there.
    missing
        Stands where nothing is written; its type is the dataset's.
    """

    def __init__(self, group: h5g.GroupID, name: str, missing: np.generic) -> None:
        self._group = group
        self._name = name.encode()
        self._missing = np.asarray(missing)
        self._dataset: h5d.DatasetID | None = None
        self._start = 0
        self._waiting: list[NDArray[Any]] = []
        self._count = 0

    def append(self, position: int, values: NDArray[Any]) -> None:
        """Take values that stand from `position` on; positions only increase."""
        if position != self._start + self._count or self._count >= BLOCK:
            self._flush()
            self._start = position
        self._waiting.append(values)
        self._count += len(values)

    def finish(self, total: int) -> h5d.DatasetID:
        """Write what is left, fill up to `total` samples, and return the dataset."""
        if self._dataset is None:
            self._dataset = self._create(total, None)
        self._flush()
        if self._dataset.shape != (total,):
            self._dataset.set_extent((total,))
        return self._dataset

    def _flush(self) -> None:
        if self._count == 0:
            return
        values = self._waiting[0] if len(self._waiting) == 1 else np.concatenate(self._waiting)
        end = self._start + self._count
        if self._dataset is None:
            self._dataset = self._create(end, h5s.UNLIMITED)
        if self._dataset.shape[0] < end:
            self._dataset.set_extent((end,))
        hdf5.write_at(self._dataset, self._start, values)
        self._waiting = []
        self._count = 0

    def _create(self, length: int, limit: int | None) -> h5d.DatasetID:
        properties = h5p.create(h5p.DATASET_CREATE)
        properties.set_fill_value(self._missing)
        if limit is not None:
            properties.set_chunk((CHUNK,))
        space = h5s.create_simple((length,), None if limit is None else (limit,))
        return h5d.create(self._group, self._name, h5t.py_create(self._missing.dtype), space, properties)


class RaggedWriter:
    """Writes one group of a packed run, trial by trial.

    Parameters
    ----------
    file
        The packed file.
    name
        Of the device (or ``command``, ``settle``).
    trials
        Number of rows of the run.
    """

    def __init__(self, file: Any, name: str, trials: int) -> None:
        self.columns: dict[tuple[str, str], str] = {}
        self._group = hdf5.create_group(file, name)
        self._trials = trials
        self._growing: dict[str, Growing] = {}
        self._index = Growing(self._group, TRIAL_INDEX, np.int32(-1))
        self._sets: dict[tuple[str, ...], int] = {}
        self._attributes: dict[str, list[Any]] = {}
        self._tares: dict[str, NDArray[np.float64]] = {}
        self._counts = np.zeros(trials, dtype=np.int64)
        self._set_of = np.full(trials, -1, dtype=np.int32)
        self._total = 0

    def append(self, row: int, index: int, table: StoredTable) -> bytes:
        """Append one trial's table, in order of rows; return the hash of what was read."""
        names = tuple(self._dataset_name(column) for column in table.columns)
        self._set_of[row] = self._sets.setdefault(names, len(self._sets))
        self._counts[row] = table.count
        self._note(row, names, table)
        positions = dict.fromkeys(names, self._total)

        def append(column: AnyColumn, values: FloatArray) -> None:
            name = self.columns[column.name, column.unit]
            self._growing[name].append(positions[name], values)
            positions[name] += len(values)

        digest = table.copy(append)
        for start in range(0, table.count, BLOCK):
            part = np.full(min(BLOCK, table.count - start), index, dtype=np.int32)
            self._index.append(self._total + start, part)
        self._total += table.count
        return digest

    def finish(self, trial_scale: h5d.DatasetID) -> None:
        """Write what is left and what is known of each trial."""
        scale = h5d.create(self._group, SAMPLE.encode(), h5t.IEEE_F32BE, h5s.create_simple((self._total,)))
        h5ds.set_scale(scale, (_DIMENSION % self._total).encode())
        index = self._index.finish(self._total)
        write_attribute(index, "long_name", "index of the trial")
        h5ds.attach_scale(index, scale, 0)
        units = {}
        for (channel, unit), name in self.columns.items():
            dataset = self._growing[name].finish(self._total)
            units[name] = unit
            write_attributes(dataset, {"units": unit} | ({} if name == channel else {"channel": channel}))
            h5ds.attach_scale(dataset, scale, 0)
        _create(self._group, FIRST, np.cumsum(self._counts) - self._counts, trial_scale, {})
        _create(self._group, COUNT, self._counts, trial_scale, {"sample_dimension": SAMPLE})
        for name, values in self._attributes.items():
            array: NDArray[Any] = np.array(values, dtype=object if KINDS[name] is str else KINDS[name])
            _create(self._group, name, array, trial_scale, {"units": _UNITS.get(name, "")})
        for name, tare in self._tares.items():
            _create(self._group, _TARE + name, tare, trial_scale, {"units": units[name]})
        sets = json.dumps([list(names) for names in self._sets])
        about = {"long_name": "which of column_sets a trial has, -1: none", "column_sets": sets}
        _create(self._group, SET, self._set_of, trial_scale, about)

    def _note(self, row: int, names: tuple[str, ...], table: StoredTable) -> None:
        for name, value in table.attributes.items():
            if name not in self._attributes:
                nothing: Any = {float: np.nan, int: 0, str: ""}[KINDS[name]]
                self._attributes[name] = [nothing] * self._trials
            self._attributes[name][row] = value
        for name, column in zip(names, table.columns, strict=True):
            if hdf5.TARE in column.attributes:
                tare = self._tares.setdefault(name, np.full(self._trials, np.nan))
                tare[row] = column.attributes[hdf5.TARE]

    def _dataset_name(self, column: AnyColumn) -> str:
        key = (column.name, column.unit)
        if key not in self.columns:
            name = column.name
            if name in _TAKEN or name.startswith(_TARE):
                name = f"channel_{name}"
            while name in self._growing:
                name += "_"  # the same channel in another unit, after the experiment changed
            self.columns[key] = name
            self._growing[name] = Growing(self._group, name, np.float64(np.nan))
        return self.columns[key]


class RaggedGroup:
    """A group that `Ragged` made, opened for reading.

    Parameters
    ----------
    group
        Of an open file.
    name
        The group's.
    """

    def __init__(self, group: h5g.GroupID, name: str) -> None:
        self.name = name
        self._group = group
        self._first = self._numbers(FIRST, np.int64)
        self._count = self._numbers(COUNT, np.int64)
        self._set = self._numbers(SET, np.int32)
        sets = read_attributes(h5d.open(group, SET.encode()))["column_sets"]
        self._sets: list[list[str]] = json.loads(str(sets))
        members = hdf5.member_names(group)
        self._attributes = {
            name: h5d.open(group, name.encode())
            if KINDS[name] is str
            else self._numbers(name, np.int64 if KINDS[name] is int else np.float64)
            for name in members
            if name in KINDS
        }
        self._tares = {
            name.removeprefix(_TARE): self._numbers(name, np.float64)
            for name in members
            if name.startswith(_TARE)
        }
        self._columns: dict[str, tuple[str, str, ReadAhead]] = {}

    def has(self, row: int) -> bool:
        """Tell whether a trial has this table."""
        return bool(self._set[row] >= 0)

    def table(self, row: int) -> StoredTable:
        """Return one trial's table; `has` it."""
        attributes: dict[str, Attribute] = {}
        for name, values in self._attributes.items():
            value = _text_at(values, row) if KINDS[name] is str else values[row].item()
            if value == value:  # noqa: PLR0124 - NaN stands for none
                attributes[name] = value
        columns = tuple(self._column(name, row) for name in self._sets[self._set[row]])
        return StoredTable(self.name, columns, attributes)

    def indices_are(self, indices: NDArray[np.int64]) -> bool:
        """Tell whether every sample is marked with its trial, given the index of every row."""
        marked = h5d.open(self._group, TRIAL_INDEX.encode())
        ends = np.cumsum(self._count)
        if marked.shape != (self._count.sum(),):
            return False
        start = 0
        for values in blocks(marked):
            rows = np.searchsorted(ends, np.arange(start, start + len(values)), side="right")
            if not np.array_equal(values, indices[rows]):
                return False
            start += len(values)
        return True

    def _column(self, name: str, row: int) -> StoredColumn:
        if name not in self._columns:
            dataset = h5d.open(self._group, name.encode())
            attributes = read_attributes(dataset)
            values = ReadAhead(dataset)
            self._columns[name] = (str(attributes.get("channel", name)), str(attributes["units"]), values)
        channel, unit, values = self._columns[name]
        tare = self._tares[name][row] if name in self._tares else np.nan
        attributes = {} if np.isnan(tare) else {hdf5.TARE: float(tare)}
        return StoredColumn(channel, unit, attributes, values, int(self._first[row]), int(self._count[row]))

    def _numbers(self, name: str, kind: Any) -> NDArray[Any]:
        return hdf5.read_array(self._group, name, kind)


def _create(
    group: h5g.GroupID,
    name: str,
    values: NDArray[Any],
    scale: h5d.DatasetID,
    attributes: Mapping[str, Attribute],
) -> None:
    dataset = hdf5.write_array(group, name, values)
    write_attributes(dataset, attributes)
    h5ds.attach_scale(dataset, scale, 0)


def _text_at(dataset: h5d.DatasetID, row: int) -> str:
    where = dataset.get_space()
    where.select_hyperslab((row,), (1,))
    values = np.empty(1, dtype=TEXT)
    dataset.read(h5s.create_simple((1,)), where, values)
    text = values.item()
    return text.decode() if isinstance(text, bytes) else str(text)
