"""A file that cannot be opened just now is not told as damaged, and nothing is taken away."""

import errno
import fcntl
import os

import pytest
from stored_runs import new_run, store_many

from labrun.errors import RecordingError
from labrun.store import RunFolder, open_run
from labrun.store.disk import InaccessibleError, inaccessible

LOCKED = "is open in another program, which has locked it"


@pytest.fixture
def locked():
    """Return a function that locks a file as another program would."""
    held = []

    def lock(path):
        descriptor = os.open(path, os.O_RDWR)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        held.append(descriptor)

    yield lock
    for descriptor in held:
        os.close(descriptor)


def test_a_packed_run_that_is_open_elsewhere_is_told_so(tmp_path, locked):
    folder = new_run(tmp_path)
    store_many(folder, 3)
    locked(folder.pack())
    for target in (folder.path, folder.path / "run.h5"):
        with pytest.raises(InaccessibleError, match=LOCKED):
            open_run(target)
    with pytest.raises(InaccessibleError, match=LOCKED):
        RunFolder.open(folder.path)


def test_a_trial_that_is_open_elsewhere_stays_where_it_is(tmp_path, locked):
    folder = new_run(tmp_path)
    store_many(folder, 3)
    trial = next((folder.path / "trials").glob("0*.h5"))
    locked(trial)
    with pytest.raises(InaccessibleError, match=LOCKED):
        RunFolder.open(folder.path)
    assert trial.is_file()


def test_a_damaged_file_is_still_told_as_damaged(tmp_path):
    path = tmp_path / "run.h5"
    path.write_bytes(b"no HDF5")
    with pytest.raises(RecordingError, match="cannot be read as a run"):
        open_run(path)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.EACCES, "Permission denied"),
        (errno.EMFILE, "Too many open files"),
        (errno.EIO, "Input/output error"),
        (errno.ESTALE, "Stale file handle"),
        (errno.ENXIO, "No such device"),
    ],
)
def test_every_error_of_the_system_says_what_it_is(tmp_path, code, words):
    refusal = inaccessible(tmp_path / "run.h5", OSError(code, "Unable to synchronously open file"))
    assert refusal is not None
    assert words in str(refusal)
    assert refusal.hint
    assert "damaged" not in str(refusal.args[0])
