"""Where the samples of each trial stand: in a file of its own, or in ``run.h5``."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from h5py import h5g

from labrun.errors import RecordingError
from labrun.store import hdf5, layout
from labrun.store.hdf5 import StoredTable
from labrun.store.ragged import RaggedGroup
from labrun.store.written import Written


@dataclass(frozen=True, slots=True)
class TrialTables:
    """The tables of one trial, wherever they are; usable while their file is open.

    Attributes
    ----------
    names
        Of all tables: devices, ``command``, ``settle``.
    """

    names: tuple[str, ...]
    _open: Callable[[str], StoredTable]

    @property
    def devices(self) -> list[str]:
        """Names of the tables that are a device's."""
        return [name for name in self.names if name not in layout.BESIDE]

    def __getitem__(self, name: str) -> StoredTable:
        return self._open(name)


class PackedTrials:
    """The trials of an open packed file.

    Parameters
    ----------
    file
        Stays open while this is used.
    """

    def __init__(self, file: Any) -> None:
        self.indices = hdf5.read_array(file, "index", np.int64)
        self._rows = {int(index): row for row, index in enumerate(self.indices)}
        names = [name for name in hdf5.group_names(file) if name != layout.RECORD]
        self.groups = {name: RaggedGroup(h5g.open(file, name.encode()), name) for name in names}

    def tables(self, index: int) -> TrialTables:
        """Return the tables of one trial; KeyError if there is none."""
        row = self._rows[index]
        names = tuple(name for name, group in self.groups.items() if group.has(row))
        return TrialTables(names, lambda name: self.groups[name].table(row))


class TrialSources:
    """Opens the trials of a run, wherever they are; a trial file counts before ``run.h5``.

    Parameters
    ----------
    packed
        ``run.h5``, which may be missing.
    files
        Trial files by index.
    written
        Of trial files that this process wrote: these are read without HDF5, if they are as they were written.
    """

    def __init__(
        self,
        packed: Path,
        files: Mapping[int, Path],
        written: Mapping[int, Written] = MappingProxyType({}),
    ) -> None:
        self._written = written
        self._path = packed
        self._files = files
        self._file: Any = None
        self._packed: PackedTrials | None = None

    def __enter__(self) -> "TrialSources":
        if self._path.is_file():
            self._file = hdf5.open_for_reading(str(self._path))
        return self

    def __exit__(self, *_: object) -> None:
        self._packed = None
        if self._file is not None:
            self._file.close()
            self._file = None

    def size(self) -> int:
        """Return how many bytes all trials take on disk now."""
        packed = self._path.stat().st_size if self._path.is_file() else 0
        return packed + sum(path.stat().st_size for path in self._files.values())

    @contextmanager
    def tables(self, index: int) -> Iterator[TrialTables]:
        """Open the tables of one trial.

        Raises
        ------
        RecordingError
            There is no such trial.
        """
        path = self._files.get(index)
        if path is None:
            yield self._packed_tables(index)
            return
        known = self._written[index].tables(path) if index in self._written else None
        if known is not None:
            yield TrialTables(tuple(known), known.__getitem__)
            return
        file = hdf5.open_for_reading(str(path))
        try:
            yield TrialTables(tuple(hdf5.member_names(file)), lambda name: hdf5.open_table(file, name))
        finally:
            file.close()

    def _packed_tables(self, index: int) -> TrialTables:
        if self._packed is None and self._file is not None:
            self._packed = PackedTrials(self._file)
        try:
            if self._packed is not None:
                return self._packed.tables(index)
        except KeyError:
            pass
        raise RecordingError(f"{self._path.parent} has no trial {index}")
