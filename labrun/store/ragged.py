"""One device's samples of all trials in one group of ``run.h5``: a contiguous ragged array of the CF conventions."""

import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.signals import MEMORY_ROWS, TIMES, LongSignals, Signals

SAMPLE = "sample"
TRIAL_INDEX = "trial_index"
FIRST = "first_sample"
COUNT = "sample_count"
SET = "column_set"
CHUNK = 1 << 14
"""Samples of a chunk (128 KiB) of a dataset that is written in several blocks."""
_OF_TRIALS = {"rate_hz": "Hz", "lost": "", "saturated": "", "clock_glitches": ""}
"""What is known of a device's signals in each trial, with units."""
_TARE = "tare_"
_TAKEN = frozenset({SAMPLE, TRIAL_INDEX, FIRST, COUNT, SET, *_OF_TRIALS})
_DIMENSION = "This is a netCDF dimension but not a netCDF variable. %9d"
"""How netCDF-4 marks a dimension scale that stands only for a dimension."""
_TOLD = ("units", "channel", "column_sets")
"""Attributes without which the numbers of a dataset mean nothing."""
Sums = dict[tuple[str, ...], int]
"""Checksum of the content of each dataset, by its name and what is told of it."""


def storable(text: str) -> str:
    """Return text as HDF5 can hold it: a zero byte, or half a character, from a garbled answer is made visible."""
    return text.replace("\0", "\N{SYMBOL FOR NULL}").encode("utf-8", "replace").decode()


def create(
    group: h5py.Group,
    name: str,
    values: NDArray[Any],
    attributes: Mapping[str, str],
    scale: h5py.Dataset | None,
) -> h5py.Dataset:
    """Write numbers, or text where the array is of objects."""
    text = values.dtype == object
    data = np.array([storable(word) for word in values], dtype=object) if text else values
    dataset = group.create_dataset(storable(name), data=data, dtype=h5py.string_dtype() if text else None)
    for key, value in attributes.items():
        dataset.attrs[key] = storable(value)
    if scale is not None:
        dataset.dims[0].attach_scale(scale)
    return dataset


class RaggedWriter:
    """Writes one group of a packed run, trial by trial, in blocks of `MEMORY_ROWS` samples."""

    def __init__(self, group: h5py.Group, trials: int) -> None:
        self.columns: dict[tuple[str, str], str] = {}
        """Name of the dataset, by name and unit of the column."""
        self._group = group
        self._parts: dict[str, list[tuple[int, NDArray[Any]]]] = {TRIAL_INDEX: []}
        self._sets: dict[tuple[str, ...], int] = {}
        self._set_of = np.full(trials, -1, dtype=np.int32)
        self._counts = np.zeros(trials, dtype=np.int64)
        self._sums: dict[str, int] = {}
        self._known: dict[str, NDArray[Any]] = {}
        self._tares: dict[str, FloatArray] = {}
        self._written = 0
        self._total = 0

    def append(self, row: int, index: int, table: LongSignals) -> None:
        """Append one trial's signals, in order of rows."""
        head = table.head
        axes = [(name, "s") for name in TIMES if getattr(head, name) is not None]
        names = tuple(
            self._dataset_name(*key) for key in (*axes, *zip(head.columns, head.units, strict=True))
        )
        self._set_of[row] = self._sets.setdefault(names, len(self._sets))
        self._counts[row] = len(table)
        for known in _OF_TRIALS if head.device_time_s is not None else ():
            value = getattr(head, known)
            nothing = np.nan if isinstance(value, float) else 0
            self._known.setdefault(known, np.full(len(self._counts), nothing))[row] = value
        for column, offset in head.tare.items():
            if column in head.columns:
                name = self.columns[column, head.unit(column)]
                self._tares.setdefault(name, np.full(len(self._counts), np.nan))[row] = offset
        for piece in table.pieces():
            times = (getattr(piece, name) for name, _ in axes)
            for name, values in zip(names, (*times, *piece.values.T), strict=True):
                self._parts[name].append((self._total, values))
            self._parts[TRIAL_INDEX].append((self._total, np.full(len(piece), index, dtype=np.int32)))
            self._total += len(piece)
            if self._total - self._written >= MEMORY_ROWS:
                self._flush()

    def finish(self, trial_scale: h5py.Dataset) -> Sums:
        """Write what is left and what is known of each trial; return what `RaggedGroup.sums` has to find."""
        group = self._group
        self._flush()
        scale = group.create_dataset(SAMPLE, shape=(self._total,), dtype=">f4")
        scale.make_scale(_DIMENSION % self._total)
        index = group[TRIAL_INDEX]
        index.attrs["long_name"] = "index of the trial"
        index.dims[0].attach_scale(scale)
        units = {}
        for (column, unit), name in self.columns.items():
            units[name] = unit
            group[name].attrs["units"] = storable(unit)
            if name != column:
                group[name].attrs["channel"] = column
            group[name].dims[0].attach_scale(scale)
        sets = json.dumps([list(names) for names in self._sets])
        about = {"long_name": "which of column_sets a trial has, -1: none", "column_sets": sets}
        of_trials: list[tuple[str, NDArray[Any], dict[str, str]]] = [
            (FIRST, np.cumsum(self._counts) - self._counts, {}),
            (COUNT, self._counts, {"sample_dimension": SAMPLE}),
            *((name, values, {"units": _OF_TRIALS[name]}) for name, values in self._known.items()),
            *((_TARE + name, tare, {"units": units[name]}) for name, tare in self._tares.items()),
            (SET, self._set_of, about),
        ]
        for name, values, attributes in of_trials:
            create(group, name, values, attributes, trial_scale)
            self._sums[name] = zlib.crc32(values.data)
        return {_told(name, group[name]): found for name, found in self._sums.items()}

    def _flush(self) -> None:
        """Write the block that waits: what fits in one block contiguous, what is larger in chunks."""
        if self._total == self._written and all(name in self._group for name in self._parts):
            return
        for name, parts in self._parts.items():
            kind, nothing = (np.int32, -1) if name == TRIAL_INDEX else (np.float64, np.nan)
            if sum(len(values) for _, values in parts) == self._total - self._written:
                block = np.concatenate([np.empty(0, kind), *(values for _, values in parts)])
            else:
                block = np.full(self._total - self._written, nothing, dtype=kind)
                for start, values in parts:
                    block[start - self._written : start - self._written + len(values)] = values
            parts.clear()
            if name not in self._sums:
                self._sums[name] = self._nothing_before(nothing, kind)
            self._sums[name] = zlib.crc32(block.data, self._sums[name])
            if self._written == 0 and self._total < MEMORY_ROWS:
                self._group.create_dataset(name, data=block)
                continue
            if name not in self._group:
                self._group.create_dataset(
                    name, (0,), kind, maxshape=(None,), chunks=(CHUNK,), fillvalue=nothing
                )
            dataset = self._group[name]
            dataset.resize((self._total,))
            dataset[self._written :] = block
        self._written = self._total

    def _nothing_before(self, nothing: float, kind: type) -> int:
        """Return the checksum of what stands before the first sample of a column that comes late."""
        found = 0
        for start in range(0, self._written, MEMORY_ROWS):
            found = zlib.crc32(np.full(min(MEMORY_ROWS, self._written - start), nothing, kind).data, found)
        return found

    def _dataset_name(self, column: str, unit: str) -> str:
        if (column, unit) not in self.columns:
            name = column
            if name in _TAKEN or name.startswith(_TARE):
                name = f"channel_{name}"
            while name in self._parts:
                name += "_"  # the same channel in another unit, after the experiment changed
            self.columns[column, unit] = name
            self._parts[name] = []
        return self.columns[column, unit]


def _told(name: str, dataset: h5py.Dataset) -> tuple[str, ...]:
    return (name, *(str(dataset.attrs.get(key, "")) for key in _TOLD))


class RaggedGroup:
    """A group that `RaggedWriter` made, opened for reading."""

    def __init__(self, group: h5py.Group) -> None:
        self._group = group
        self._first = group[FIRST][()]
        self._count = group[COUNT][()]
        self._set = group[SET][()]
        self._sets: list[list[str]] = json.loads(group[SET].attrs["column_sets"])
        self._known = {name: group[name][()] for name in _OF_TRIALS if name in group}
        self._tares = {name.removeprefix(_TARE): group[name][()] for name in group if name.startswith(_TARE)}
        self._columns: dict[str, tuple[str, str, h5py.Dataset]] = {}
        self._block: dict[str, FloatArray] = {}
        self._start = 0

    def has(self, row: int) -> bool:
        """Tell whether a trial has these signals."""
        return bool(self._set[row] >= 0)

    def signals(self, name: str, row: int) -> LongSignals:
        """Return one trial's signals; `has` them."""
        names = self._sets[self._set[row]]
        columns = [(*self._column(one), one) for one in names]
        axes = {column: one for column, _, _, one in columns if column in TIMES}
        measured = [(column, unit, one) for column, unit, _, one in columns if column not in TIMES]
        tare = {
            column: float(self._tares[one][row])
            for column, _, one in measured
            if one in self._tares and not np.isnan(self._tares[one][row])
        }
        known = {key: values[row].item() for key, values in self._known.items()}
        none = np.empty(0)
        times = {axis: none if axis in axes else None for axis in TIMES}
        head = Signals(
            name,
            tuple(column for column, _, _ in measured),
            tuple(unit for _, unit, _ in measured),
            values=np.empty((0, len(measured))),
            tare=tare,
            **{**times, "time_s": none},  # type: ignore[arg-type]
            **(known if "device_time_s" in axes else {}),
        )
        first, count = int(self._first[row]), int(self._count[row])

        def pieces(skipped: int) -> Iterator[Signals]:
            begin = first + skipped
            for start in range(begin, max(first + count, begin + 1), MEMORY_ROWS):
                length = min(MEMORY_ROWS, first + count - start)
                read: dict[str, Any] = {axis: self._read(one, start, length) for axis, one in axes.items()}
                values = [self._read(one, start, length) for _, _, one in measured]
                yield replace(
                    head, values=np.column_stack(values) if values else np.empty((length, 0)), **read
                )

        return LongSignals(head, count, pieces)

    def sums(self) -> Sums:
        """Return the checksums of everything, read to the last sample."""
        found = {}
        for name, dataset in self._group.items():
            if name == SAMPLE:  # the dimension
                continue
            total = 0
            for start in range(0, len(dataset), MEMORY_ROWS):
                total = zlib.crc32(dataset[start : start + MEMORY_ROWS].data, total)
            found[_told(name, dataset)] = total
        return found

    def _column(self, name: str) -> tuple[str, str, h5py.Dataset]:
        """Return a column's own name, its unit, and its dataset."""
        if name not in self._columns:
            dataset = self._group[name]
            self._columns[name] = (dataset.attrs.get("channel", name), dataset.attrs["units"], dataset)
        return self._columns[name]

    def _read(self, name: str, start: int, count: int) -> FloatArray:
        """Return samples of one dataset; what is read for one trial has the next ones in it, too."""
        if count == 0:
            return np.empty(0)
        if not self._start <= start <= start + count <= self._start + len(self._block.get(name, ())):
            if start != self._start:
                self._start, self._block = start, {}
            ahead = max(count, min(CHUNK, MEMORY_ROWS))
            self._block[name] = self._column(name)[2][start : start + ahead]
        first = start - self._start
        values: FloatArray = self._block[name][first : first + count]
        return values
