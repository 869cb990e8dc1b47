"""A whole run in one file: plain HDF5 that is valid netCDF-4, verified before the trial files go."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from labrun.errors import StoreError
from labrun.store import packed_file
from labrun.store.disk import fsync_directory, fsync_file, saving
from labrun.store.folder import PACKED, TRIALS, RunFolder
from labrun.store.sources import TrialSources
from labrun.store.trial import TrialOutcome
from labrun.store.trial_file import trial_files


def pack(folder: RunFolder) -> Path:
    """Put all trials of a run into ``run.h5``, verify it, and only then remove the trial files.

    A run that was packed before and went on is packed anew from both. A crash at any instant leaves the old
    state, the new state, or the new state with trial files that are in it too.

    Parameters
    ----------
    folder
        The run; the caller holds its lock.

    Returns
    -------
    Path
        The packed file.

    Raises
    ------
    StoreError
        The disk is full, or what was written differs from the trials: these are untouched, ``run.h5`` as before.
    """
    target = folder.path / PACKED
    outcomes = folder.outcomes()
    files = {index: path for index, path in trial_files(folder.path / TRIALS).items() if index in outcomes}
    with TrialSources(target, files, folder.written) as sources:
        if not (
            target.is_file()
            and packed_file.holds(target, outcomes, packed_file.digests_of(outcomes, sources))
        ):
            _write_verified(folder, target, outcomes, sources)
    folder.journal.append("packed", trials=len(outcomes))
    _remove_trials(folder, files)
    return target


def _write_verified(
    folder: RunFolder, target: Path, outcomes: Mapping[int, TrialOutcome], sources: TrialSources
) -> None:
    partial = target.with_name(f"{PACKED}.partial")
    try:
        with saving(PACKED, folder.path, f"all {len(outcomes)} trials are untouched"):
            digests = packed_file.write(partial, folder.texts(), outcomes, sources)
            fsync_file(partial)
            if not packed_file.holds(partial, outcomes, digests):
                raise StoreError(
                    f"{partial} does not hold what was written to it; all {len(outcomes)} trials are untouched",
                    hint="the disk or the memory of this machine may be failing: copy the run elsewhere",
                )
            partial.replace(target)
            fsync_directory(folder.path)
    except BaseException:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def _remove_trials(folder: "RunFolder", files: Mapping[int, Path]) -> None:
    """Remove what is in ``run.h5`` now; damaged trials that were moved aside stay, with their folder."""
    trials = folder.path / TRIALS
    with saving("the removal of packed trials", folder.path, f"everything is in {PACKED}"):
        for path in files.values():
            path.unlink()
        folder.log.remove()
        with suppress(OSError):
            trials.rmdir()
        fsync_directory(folder.path)
