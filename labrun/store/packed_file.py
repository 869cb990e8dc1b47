"""The layout of ``run.h5``: a table of trials at its root, the texts of the run, and one group a device.

``xarray.open_dataset("run.h5")`` is the table, one row a trial. With ``group="wrench"`` it has the samples of that
device in all trials, one after the other (see `labrun.store.ragged`): trial `row` is
``wrench.isel(sample=slice(first, first + count))`` by its ``first_sample`` and ``sample_count``, and trial 12 is
``wrench.isel(sample=wrench.trial_index == 12)``. (``wrench.where`` would spread the table over every sample.)

A group a trial and device would be the plain way. But every dataset costs, and h5netcdf finds the dimensions of each
by a search through the file: with three groups a trial, ``xarray.open_datatree`` took 89 s for 300 trials and grows
with their square (hours for a sweep of 2300), where one group a device opens in 0.1 s however many trials there are.
Samples are not compressed.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from h5py import h5d, h5g

from labrun.errors import RecordingError
from labrun.store import hdf5, layout, table
from labrun.store.attributes import read_text, write_attributes, write_text
from labrun.store.ragged import RaggedWriter
from labrun.store.sources import PackedTrials, TrialSources, TrialTables
from labrun.store.table import AXIS, Variable
from labrun.store.trial import TrialOutcome

T = TypeVar("T")

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


def write(
    path: Path, texts: RunTexts, outcomes: Mapping[int, TrialOutcome], sources: TrialSources
) -> dict[int, bytes]:
    """Write a whole run to a new file; memory stays bounded by one block of each dataset.

    Returns
    -------
    dict of bytes
        Hash of what was read of each trial, for `holds`.

    Raises
    ------
    OSError
        The disk is full or fails.
    """
    outcomes_jsonl = "".join(f"{outcome.to_json()}\n" for outcome in outcomes.values())
    with hdf5.flush_errors():
        file = hdf5.create_on_disk(str(path))
        try:
            rest = sum(len(text) for text in astuple(texts)) + len(outcomes_jsonl)
            hdf5.reserve(file, int(1.25 * sources.size()) + 4 * rest + _SPARE)
            write_attributes(
                file, {"Conventions": "CF-1.11", "experiment": texts.experiment, "run": texts.run}
            )
            groups, digests = _write_samples(file, outcomes, sources)
            variables = table.variables(list(outcomes.values()), _units(texts, groups), groups)
            scale = _write_table(file, variables)
            for group in groups.values():
                group.finish(scale)
            record = hdf5.create_group(file, layout.RECORD)
            for field in fields(RunTexts):
                write_text(record, field.name, getattr(texts, field.name))
            write_text(record, _OUTCOMES, outcomes_jsonl)
            hdf5.close(file)
        except BaseException:
            with suppress(Exception):
                file.close()
            raise
    return digests


def digests_of(outcomes: Mapping[int, TrialOutcome], sources: TrialSources) -> dict[int, bytes]:
    """Return a hash of everything in each trial, read to the last sample."""
    found = {}
    for index in outcomes:
        with sources.tables(index) as tables:
            found[index] = _digest(tables)
    return found


def holds(path: Path, outcomes: Mapping[int, TrialOutcome], digests: Mapping[int, bytes]) -> bool:
    """Tell whether a packed file, read anew as any reader would, holds exactly these outcomes and trials."""
    if read_outcomes(path) != outcomes:
        return False
    file = hdf5.open_for_reading(str(path))
    try:
        packed = PackedTrials(file)
        return (
            packed.indices.tolist() == list(outcomes)
            and all(group.indices_are(packed.indices) for group in packed.groups.values())
            and all(_digest(packed.tables(index)) == digests[index] for index in outcomes)
        )
    finally:
        file.close()


def read_outcomes(path: Path) -> dict[int, TrialOutcome]:
    """Return the outcomes in a packed run by index; empty if there is no such file.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """

    def read(file: Any) -> dict[int, TrialOutcome]:
        lines = read_text(h5g.open(file, layout.RECORD.encode()), _OUTCOMES).split("\n")[:-1]
        return {outcome.index: outcome for outcome in map(TrialOutcome.from_json, lines)}

    return _reading(path, read) if path.is_file() else {}


def read_texts(path: Path) -> RunTexts:
    """Return the texts of a packed run.

    Raises
    ------
    RecordingError
        The file is missing, damaged, or no run.
    """

    def read(file: Any) -> RunTexts:
        record = h5g.open(file, layout.RECORD.encode())
        return RunTexts(**{field.name: read_text(record, field.name) for field in fields(RunTexts)})

    return _reading(path, read)


def _units(texts: RunTexts, groups: Mapping[str, RaggedWriter]) -> dict[str, str]:
    channel_units = {
        f"{name}.{channel}": unit
        for name, group in groups.items()
        for channel, unit in reversed(group.columns)  # what a channel had first counts
        if name not in layout.BESIDE and channel not in layout.TIMES
    }
    return table.known_units(texts.spec_toml, channel_units)


def _write_table(file: Any, variables: list[Variable]) -> h5d.DatasetID:
    """Write the table; the index of the trials is its axis. Return the scale."""
    axis = Variable(AXIS, "", variables[0].values, "trial")
    scale = None
    for variable in [axis, *variables]:
        dataset = hdf5.write_array(file, variable.name, variable.values)
        write_attributes(dataset, {"units": variable.unit, "kind": variable.kind})
        scale = hdf5.join_axis(dataset, variable.name, scale)
    return scale


def _write_samples(
    file: Any, outcomes: Mapping[int, TrialOutcome], sources: TrialSources
) -> tuple[dict[str, RaggedWriter], dict[int, bytes]]:
    groups: dict[str, RaggedWriter] = {}
    digests: dict[int, bytes] = {}
    for row, index in enumerate(outcomes):
        with sources.tables(index) as tables:
            parts = {}
            for name in tables.names:
                if name not in groups:
                    groups[name] = RaggedWriter(file, name, len(outcomes))
                parts[name] = groups[name].append(row, index, tables[name])
            digests[index] = b"".join(parts[name] for name in sorted(parts))
    return groups, digests


def _digest(tables: TrialTables) -> bytes:
    return b"".join(tables[name].copy() for name in sorted(tables.names))


def _reading(path: Path, read: Callable[[Any], T]) -> T:
    try:
        file = hdf5.open_for_reading(str(path))
        try:
            return read(file)
        finally:
            file.close()
    except Exception as error:  # a damaged or foreign file fails anywhere in HDF5, in many ways
        raise RecordingError(
            f"{path} cannot be read as a run of labrun: {error}",
            hint="run.h5 was whole when it was written: restore it from a copy",
        ) from error
