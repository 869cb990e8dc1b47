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
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import asdict, astuple, dataclass
from functools import cached_property
from pathlib import Path

import h5py

from labrun.errors import RecordingError
from labrun.signals import TIMES, LongSignals
from labrun.store.disk import flush_errors, require_room
from labrun.store.ragged import RaggedGroup, RaggedWriter, Sums, create, storable
from labrun.store.table import AXIS, Variable, known_units, variables
from labrun.store.trial import TrialOutcome, json_ready
from labrun.store.trial_file import BESIDE, RECORD

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
        found = variables(list(outcomes.values()), known_units(texts.spec_toml, units), groups)
        scale = _write_table(file, found)
        sums = {name: group.finish(scale) for name, group in groups.items()}
        sums[RECORD] = _sum_of(lines)
        record = file.create_group(RECORD, track_order=True)
        for name, text in (*asdict(texts).items(), (_OUTCOMES, lines)):
            record[name] = storable(text)
    return sums


def _write_table(file: h5py.File, found: Sequence[Variable]) -> h5py.Dataset:
    """Write the table; the index of the trials is its axis. Return the scale."""
    scale = create(file, AXIS, found[0].values, {"units": "", "kind": "trial"}, None)
    scale.make_scale(AXIS)
    for variable in found:
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
        found = {name: group.sums() for name, group in self._groups.items()}
        return list(self._rows) == list(outcomes) and {**found, RECORD: _sum_of(self._lines)} == sums


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
    return "".join(f"{json.dumps(one.to_record(), default=json_ready)}\n" for one in outcomes.values())


def _outcomes(lines: str) -> dict[int, TrialOutcome]:
    found = (TrialOutcome.from_record(json.loads(line)) for line in lines.split("\n")[:-1])
    return {outcome.index: outcome for outcome in found}


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
        raise unreadable(path, error) from error


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
