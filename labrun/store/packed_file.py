"""The layout of ``run.h5``: a table of trials at its root, the texts of the run, and one group a device.

``xarray.open_dataset("run.h5")`` is the table, one row a trial. With ``group="wrench"`` it has the samples of that
device in all trials, one after the other: a contiguous ragged array of the CF conventions. Over the dimension
``sample`` stand the columns, and ``trial_index``; over ``trial`` stand ``first_sample``, ``sample_count`` and what else
is known of each trial. Trial `row` is ``wrench.isel(sample=slice(first, first + count))``, and trial 12 is
``wrench.isel(sample=wrench.trial_index == 12)``. (``wrench.where`` would spread the table over every sample.) A trial
without the device has ``sample_count`` 0; a channel that one trial lacks is NaN there, and ``column_set`` tells which
columns each trial really has. The trial's index cannot be called ``trial``: beside variables over the dimension of
that name xarray takes it for their coordinate.

A group a trial and device would be the plain way. But h5netcdf finds the dimensions of each dataset by a search
through the file: with three groups a trial, ``xarray.open_datatree`` took 89 s for 300 trials and grows with their
square, where one group a device opens in 0.1 s however many trials there are. Samples are not compressed.
"""

import json
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import asdict, astuple, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import RecordingError
from labrun.signals import MEMORY_ROWS, TIMES, LongSignals, Signals
from labrun.store.disk import flush_errors, inaccessible, require_room
from labrun.store.trial import AXIS, TrialOutcome, Variable, json_ready, known_units, variables
from labrun.store.trial_file import BESIDE, RECORD

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
        return {_told(name, group[name]): checksum for name, checksum in self._sums.items()}

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
        checksum = 0
        for start in range(0, self._written, MEMORY_ROWS):
            checksum = zlib.crc32(
                np.full(min(MEMORY_ROWS, self._written - start), nothing, kind).data, checksum
            )
        return checksum

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
        columns = [(*self._column(column_name), column_name) for column_name in names]
        axes = {column: column_name for column, _, _, column_name in columns if column in TIMES}
        measured = [
            (column, unit, column_name) for column, unit, _, column_name in columns if column not in TIMES
        ]
        tare = {
            column: float(self._tares[column_name][row])
            for column, _, column_name in measured
            if column_name in self._tares and not np.isnan(self._tares[column_name][row])
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
                read: dict[str, Any] = {
                    axis: self._read(stored, start, length) for axis, stored in axes.items()
                }
                values = [self._read(column_name, start, length) for _, _, column_name in measured]
                yield replace(
                    head, values=np.column_stack(values) if values else np.empty((length, 0)), **read
                )

        return LongSignals(head, count, pieces)

    def sums(self) -> Sums:
        """Return the checksums of everything, read to the last sample."""
        axes_read = {}
        for name, dataset in self._group.items():
            if name == SAMPLE:  # the dimension
                continue
            total = 0
            for start in range(0, len(dataset), MEMORY_ROWS):
                total = zlib.crc32(dataset[start : start + MEMORY_ROWS].data, total)
            axes_read[_told(name, dataset)] = total
        return axes_read

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


FORMAT = 3
"""Of run folders and ``run.h5``; those of older code have none, and are refused."""
_OUTCOMES = "outcomes_jsonl"
_SPARE = 4 << 20
"""Bytes beside what the trials take now: the table, and chunks that are not full."""


@dataclass(frozen=True, slots=True)
class RunTexts:
    """What a run is, beside its trials; with these in it, ``run.h5`` stands alone."""

    experiment: str
    run: str
    spec_toml: str
    provenance_json: str
    journal_jsonl: str


def write_packed(
    path: Path,
    texts: RunTexts,
    outcomes: Mapping[int, TrialOutcome],
    tables: Callable[[int], AbstractContextManager[Mapping[str, LongSignals]]],
    size: int,
) -> dict[str, Sums]:
    """Write a whole run to a new file; memory stays bounded by one block of each dataset.

    Parameters
    ----------
    tables
        Gives the signals of a trial.
    size
        Bytes that the trials take on disk now.

    Returns
    -------
    dict
        Checksums of each group, for `holds`.

    Raises
    ------
    OSError
        The disk is full or fails.
    """
    lines = _lines_of(outcomes)
    rest = sum(len(text) for text in astuple(texts)) + len(lines)
    require_room(path, int(1.25 * size) + 4 * rest + _SPARE)
    groups: dict[str, RaggedWriter] = {}
    with flush_errors(), h5py.File(path, "w", track_order=True) as file:
        file.attrs.update(
            {"Conventions": "CF-1.11", "experiment": texts.experiment, "run": texts.run, "format": FORMAT}
        )
        for row, index in enumerate(outcomes):
            with tables(index) as opened:
                for name, table in opened.items():
                    if name not in groups:
                        groups[name] = RaggedWriter(file.create_group(name, track_order=True), len(outcomes))
                    groups[name].append(row, index, table)
        units = {
            f"{name}.{column}": unit
            for name, group in groups.items()
            for column, unit in reversed(group.columns)  # what a channel had first counts
            if name not in BESIDE and column not in TIMES
        }
        table_variables = variables(list(outcomes.values()), known_units(texts.spec_toml, units), groups)
        scale = _write_table(file, table_variables)
        sums = {name: group.finish(scale) for name, group in groups.items()}
        sums[RECORD] = _sum_of(lines)
        record = file.create_group(RECORD, track_order=True)
        for name, text in (*asdict(texts).items(), (_OUTCOMES, lines)):
            record[name] = storable(text)
    return sums


def _write_table(file: h5py.File, table_variables: Sequence[Variable]) -> h5py.Dataset:
    """Write the table; the index of the trials is its axis. Return the scale."""
    scale = create(file, AXIS, table_variables[0].values, {"units": "", "kind": "trial"}, None)
    scale.make_scale(AXIS)
    for variable in table_variables:
        create(file, variable.name, variable.values, {"units": variable.unit, "kind": variable.kind}, scale)
    return scale


class PackedTrials:
    """The trials of a packed file, open for reading until `close`.

    `locked`: as for `labrun.store.trial_file.TrialFile`. Raises RecordingError: the file is missing, damaged, or no
    run; or a run of older code.
    """

    def __init__(self, path: Path, *, locked: bool = True) -> None:
        self._file, self.texts, self._lines = _opened(path, locked=locked)
        indices = self._file["index"][()]
        self._rows = {int(index): row for row, index in enumerate(indices)}
        self._groups = {
            name: RaggedGroup(group)
            for name, group in self._file.items()
            if isinstance(group, h5py.Group) and name != RECORD
        }

    @cached_property
    def outcomes(self) -> dict[int, TrialOutcome]:
        """Outcome of every trial by index, as it was when the run was packed."""
        return _outcomes(self._lines)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __contains__(self, index: int) -> bool:
        return index in self._rows

    def tables(self, index: int) -> dict[str, LongSignals]:
        """Return the signals of one trial by name; KeyError if there is none."""
        row = self._rows[index]
        return {name: group.signals(name, row) for name, group in self._groups.items() if group.has(row)}

    def holds(self, outcomes: Mapping[int, TrialOutcome], sums: Mapping[str, Sums]) -> bool:
        """Tell whether the file holds exactly these outcomes and signals, reading all of it."""
        checksums = {name: group.sums() for name, group in self._groups.items()}
        return list(self._rows) == list(outcomes) and {**checksums, RECORD: _sum_of(self._lines)} == sums


def holds(path: Path, outcomes: Mapping[int, TrialOutcome], sums: Mapping[str, Sums]) -> bool:
    """Tell whether a packed file, read anew as any reader would, holds exactly these outcomes and signals."""
    try:
        with closing(PackedTrials(path)) as packed:
            return packed.holds(outcomes, sums)
    except RecordingError:
        return False


def read_outcomes(path: Path) -> dict[int, TrialOutcome]:
    """Return the outcomes in a packed run by index; empty if there is no such file.

    Raises RecordingError: the file is damaged, or no run; or a run of older code.
    """
    if not path.is_file():
        return {}
    file, _, lines = _opened(path)
    file.close()
    return _outcomes(lines)


def _sum_of(lines: str) -> Sums:
    return {(_OUTCOMES,): zlib.crc32(lines.encode())}


def _lines_of(outcomes: Mapping[int, TrialOutcome]) -> str:
    return "".join(
        f"{json.dumps(outcome.to_record(), default=json_ready)}\n" for outcome in outcomes.values()
    )


def _outcomes(lines: str) -> dict[int, TrialOutcome]:
    outcomes = (TrialOutcome.from_record(json.loads(line)) for line in lines.split("\n")[:-1])
    return {outcome.index: outcome for outcome in outcomes}


def _opened(path: Path, *, locked: bool = True) -> tuple[h5py.File, RunTexts, str]:
    """Open a packed run; return its file, its texts, and its outcomes as lines of JSON."""
    try:
        with ExitStack() as opened:
            file = opened.enter_context(h5py.File(path, "r", locking=None if locked else False))
            record = {name: text.asstr()[()] for name, text in file[RECORD].items()}
            if file.attrs.get("format") != FORMAT:
                raise older(path)
            lines = record.pop(_OUTCOMES)
            opened.pop_all()
            return file, RunTexts(**record), lines
    except RecordingError:
        raise
    except Exception as error:  # a damaged or foreign file fails anywhere in HDF5, in many ways
        raise inaccessible(path, error) or unreadable(path, error) from error


def older(path: Path) -> RecordingError:
    """Return the refusal of a run that older code made."""
    return RecordingError(
        f"{path} was made by an earlier labrun, in a layout that this one does not read: run it again, or open it "
        "with the labrun of its provenance.json"
    )


_ROBOTS, _LOGS = (".xml", ".urdf"), (".mcap", ".bag", ".db3", ".parquet", ".csv", ".npz")


def unreadable(path: Path, error: Exception) -> RecordingError:
    """Return why a file is no run: it is something else, or a run.h5 that is damaged."""
    reads = (
        "labrun reads run folders, their run.h5, and recordings: folders with recording.toml and CSV files"
    )
    if path.suffix not in (".h5", ".nc"):
        what = f"a {path.suffix} file" if path.suffix else "a file"
        if path.suffix in _ROBOTS:
            reads += f"; a robot's file takes a log beside it: labrun gap diagnose {path} --log run.mcap"
        elif path.suffix in _LOGS:
            reads += f"; a robot's log takes the robot's file: labrun gap diagnose arm.xml --log {path}"
        return RecordingError(f"{path} is {what}, and no run of labrun", hint=reads)
    return RecordingError(
        f"{path} cannot be read as a run of labrun: {error}",
        hint=f"if labrun wrote it, it was whole then: restore it from a copy; {reads}",
    )
