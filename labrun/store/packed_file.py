"""The layout of ``run.h5``: a table at its root, the texts of the run, and one group a trial."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from h5py import h5g

from labrun.errors import RecordingError
from labrun.store import hdf5, layout, table
from labrun.store.attributes import read_text, write_attributes, write_text
from labrun.store.sources import TRIALS, TrialSources, packed_group
from labrun.store.trial import TrialOutcome

T = TypeVar("T")

RECORD = "record"
"""Group with the texts beside the data."""

_SPARE = 1 << 20
"""Bytes for the table and the groups around the trials, whose own size is known."""


@dataclass(frozen=True, slots=True)
class RunTexts:
    """What a run is, beside its trials; with these in it, ``run.h5`` stands alone."""

    experiment: str
    run: str
    spec_toml: str
    provenance_json: str
    journal_jsonl: str


def write(path: Path, texts: RunTexts, outcomes: Mapping[int, TrialOutcome], sources: TrialSources) -> None:
    """Write a whole run to a new file; memory stays bounded by one block of one dataset.

    Raises
    ------
    OSError
        The disk is full or fails.
    """
    channel_units: dict[str, str] = {}
    rest = sum(len(text) for text in astuple(texts)) + sum(
        len(outcome.to_json()) for outcome in outcomes.values()
    )
    with hdf5.flush_errors():
        file = hdf5.create_on_disk(str(path))
        try:
            hdf5.reserve(file, sources.size() + 4 * rest + _SPARE)
            trials = hdf5.create_group(file, TRIALS)
            for index, outcome in outcomes.items():
                group = hdf5.create_group(trials, f"{index:06d}")
                layout.write_outcome(group, outcome)
                with sources.group(index) as source:
                    for name in hdf5.member_names(source):
                        hdf5.copy_table(source, group, name)
                    channel_units = channel_units or layout.channel_units(source)
            units = table.known_units(texts.spec_toml, channel_units)
            hdf5.write_variables(file, "trial", table.variables(list(outcomes.values()), units))
            _write_texts(file, texts)
            hdf5.close(file)
        except BaseException:
            with suppress(Exception):
                file.close()
            raise


def equals(path: Path, outcomes: Mapping[int, TrialOutcome], sources: TrialSources) -> bool:
    """Tell whether a packed file holds exactly these trials: outcomes, and every sample by a hash of both sides."""
    if read_outcomes(path) != outcomes:
        return False
    file = hdf5.open_for_reading(str(path))
    try:
        for index in outcomes:
            with sources.group(index) as source:
                if hdf5.digest(packed_group(file, index)) != hdf5.digest(source):
                    return False
    finally:
        file.close()
    return True


def read_outcomes(path: Path) -> dict[int, TrialOutcome]:
    """Return the outcomes in a packed run by index; empty if there is no such file.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """

    def read(file: Any) -> dict[int, TrialOutcome]:
        trials = h5g.open(file, TRIALS.encode())
        names = hdf5.member_names(trials)
        return {int(name): layout.read_outcome(h5g.open(trials, name.encode())) for name in names}

    return _reading(path, read) if path.is_file() else {}


def read_texts(path: Path) -> RunTexts:
    """Return the texts of a packed run.

    Raises
    ------
    RecordingError
        The file is missing, damaged, or no run.
    """

    def read(file: Any) -> RunTexts:
        record = h5g.open(file, RECORD.encode())
        return RunTexts(**{field.name: read_text(record, field.name) for field in fields(RunTexts)})

    return _reading(path, read)


def _write_texts(file: Any, texts: RunTexts) -> None:
    write_attributes(file, {"experiment": texts.experiment, "run": texts.run})
    record = hdf5.create_group(file, RECORD)
    for field in fields(RunTexts):
        write_text(record, field.name, getattr(texts, field.name))


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
