"""A full disk ends the trial in flight with a clear word, and damages nothing that is stored."""

import errno
import os
import resource
import shutil
import subprocess
import sys
from multiprocessing import get_context
from pathlib import Path

import pytest
import stored_runs

from labrun.errors import StoreError
from labrun.store import trial_file as writer_module
from labrun.store.folder import RunFolder

FILL = """
import sys
from pathlib import Path
import stored_runs
from labrun.errors import StoreError
from labrun.store.folder import RunFolder
folder = stored_runs.new_run(Path(sys.argv[1]))
stored = {}
try:
    with folder.lock():
        for index in range(10_000):
            stored[index] = stored_runs.store(folder, index, count=2000)
    raise SystemExit("the disk never got full")
except StoreError as error:
    assert "the disk is full" in str(error), error
    assert f"{len(stored)} trials are saved" in str(error), error
    assert "labrun resume" in str(error), error
assert not list(folder.path.glob("**/*.partial"))
opened = RunFolder.open(folder.path)
assert opened.faults == [], opened.faults
assert opened.outcomes() == stored
try:
    opened.pack()
    raise SystemExit("packing found room on a full disk")
except StoreError as error:
    assert "trials are untouched" in str(error), error
assert not list(folder.path.glob("**/*.partial"))
assert RunFolder.open(folder.path).outcomes() == stored
ballast = Path(sys.argv[1]) / "ballast"
ballast.unlink()
stored[len(stored)] = stored_runs.store(opened, len(stored))
assert RunFolder.open(folder.path).outcomes() == stored
print("survived")
"""


def refuse(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_disk_that_is_really_full_is_survived(tmp_path):
    if shutil.which("unshare") is None:
        pytest.skip("needs unshare for a small disk of its own")
    fill = f"mount -t tmpfs -o size=4m tmpfs {tmp_path} && head -c 1000000 /dev/zero > {tmp_path}/ballast"
    if subprocess.run(["unshare", "-rm", "sh", "-c", fill], check=False, capture_output=True).returncode != 0:
        pytest.skip("this machine does not allow a mount in a namespace")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    script = tmp_path.parent / "fill.py"
    script.write_text(FILL)
    command = f"{fill} && exec {sys.executable} {script} {tmp_path}"
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", command], check=False, capture_output=True, text=True, env=environment
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "survived\n", "")


@pytest.mark.parametrize("spill_bytes", [writer_module.SPILL_BYTES, 50_000], ids=["in memory", "spilled"])
def test_a_trial_that_does_not_fit_says_what_is_saved_and_what_is_free(tmp_path, spill_bytes):
    def limited() -> None:
        writer_module.SPILL_BYTES = spill_bytes
        folder = stored_runs.new_run(tmp_path)
        stored = stored_runs.store_many(folder, 2)
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
        with pytest.raises(
            StoreError, match=r"trial 2 could not be written .* free on this disk; 2 trials are saved"
        ):
            stored_runs.store(folder, 2, count=20_000)
        assert not list(folder.path.glob("**/*.partial"))
        assert RunFolder.open(folder.path).outcomes() == stored
        stored_runs.store(folder, 2)
        assert sorted(RunFolder.open(folder.path).outcomes()) == [0, 1, 2]

    process = get_context("fork").Process(target=limited)
    process.start()
    process.join()
    assert process.exitcode == 0


@pytest.mark.parametrize("count", [200, 20_000], ids=["small", "large"])
def test_a_sync_that_fails_fails_the_trial_and_leaves_no_file_of_it(tmp_path, monkeypatch, count):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store_many(folder, 2)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", refuse)
        with pytest.raises(StoreError, match="the disk is full"):
            stored_runs.store(folder, 2, count=count)
    assert sorted(path.name for path in (folder.path / "trials").glob("*.h5*")) == ["000000.h5", "000001.h5"]
    assert folder.outcomes() == stored
    assert RunFolder.open(folder.path).outcomes() == stored


def test_a_run_that_cannot_begin_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(StoreError, match="nothing was begun"):
        stored_runs.new_run(tmp_path)


def test_packing_onto_a_full_disk_keeps_the_trials(tmp_path, monkeypatch):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store_many(folder, 3)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", refuse)
        with pytest.raises(StoreError, match="all 3 trials are untouched"):
            folder.pack()
    assert not (folder.path / "run.h5").exists()
    assert not (folder.path / "run.h5.partial").exists()
    assert RunFolder.open(folder.path).outcomes() == stored
