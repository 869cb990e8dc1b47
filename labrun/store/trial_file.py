"""Trial files as they lie on disk: which are there, whether they are whole, and what is in them."""

from pathlib import Path
from typing import Any

from labrun.errors import RecordingError
from labrun.store import hdf5, layout
from labrun.store.trial import TrialOutcome
from labrun.store.written import digest_of


def trial_files(trials: Path) -> dict[int, Path]:
    """Return the trial files of a folder by index, in order; empty if there is no such folder."""
    if not trials.is_dir():
        return {}
    found = (path for path in trials.iterdir() if path.suffix == ".h5" and path.stem.isdigit())
    return {int(path.stem): path for path in sorted(found)}


def check(path: Path, described: dict[str, Any] | None) -> TrialOutcome:
    """Read a trial's outcome after making sure that its file is whole.

    Parameters
    ----------
    described
        The journal's ``trial`` event of this file (size and digest); None where that line was lost: then every
        dataset is read instead.

    Raises
    ------
    RecordingError
        The file is cut short or altered; says how.
    """
    size = path.stat().st_size
    if described is not None and described.get("bytes", size) != size:
        raise RecordingError(f"{path} has {size} bytes of the {described['bytes']} that were written")
    if (
        described is not None
        and "blake2b" in described
        and digest_of(path.read_bytes()) != described["blake2b"]
    ):
        raise RecordingError(f"{path} is not what was written: its content changed on the disk")
    try:
        file = hdf5.open_for_reading(str(path))
        try:
            outcome = layout.read_outcome(file)
            if described is None:
                for name in hdf5.member_names(file):
                    hdf5.open_table(file, name).copy()
        finally:
            file.close()
    except Exception as error:  # a damaged file fails anywhere in HDF5, in many ways
        raise RecordingError(f"{path} cannot be read: {error}") from error
    if outcome.index != int(path.stem):
        raise RecordingError(f"{path} holds trial {outcome.index}")
    return outcome
