"""Where the samples of each trial stand: in a file of its own, or in ``run.h5``."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from h5py import h5g

from labrun.errors import RecordingError
from labrun.store import hdf5

TRIALS = "trials"
"""Group of a packed run, and folder of one that is not."""


class TrialSources:
    """Opens the trials of a run, wherever they are; a trial file counts before ``run.h5``.

    Parameters
    ----------
    packed
        ``run.h5``, which may be missing.
    files
        Trial files by index.
    """

    def __init__(self, packed: Path, files: Mapping[int, Path]) -> None:
        self._packed = packed
        self._files = files
        self._open: Any = None

    def __enter__(self) -> "TrialSources":
        if self._packed.is_file():
            self._open = hdf5.open_for_reading(str(self._packed))
        return self

    def __exit__(self, *_: object) -> None:
        if self._open is not None:
            self._open.close()
            self._open = None

    def size(self) -> int:
        """Return how many bytes all trials take on disk now."""
        packed = self._packed.stat().st_size if self._packed.is_file() else 0
        return packed + sum(path.stat().st_size for path in self._files.values())

    @contextmanager
    def group(self, index: int) -> Iterator[Any]:
        """Open the group of one trial.

        Raises
        ------
        RecordingError
            There is no such trial.
        """
        path = self._files.get(index)
        if path is not None:
            file = hdf5.open_for_reading(str(path))
            try:
                yield file
            finally:
                file.close()
            return
        try:
            group = packed_group(self._open, index)
        except (KeyError, AttributeError, TypeError):
            raise RecordingError(f"{self._packed.parent} has no trial {index}") from None
        yield group


def packed_group(file: Any, index: int) -> Any:
    """Return the group of one trial in a packed run; KeyError if there is none."""
    return h5g.open(file, f"{TRIALS}/{index:06d}".encode())
