"""kill -9 at any instant costs at most the trial in flight."""

import os
import shutil
import signal
import subprocess
import sys
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import stored_runs

from labrun.errors import RigBusyError
from labrun.store import disk
from labrun.store.folder import RunFolder
from labrun.store.reading import open_run

WRITE = """
import sys
from pathlib import Path
import stored_runs
from labrun.store.folder import RunFolder
folder = RunFolder.open(Path(sys.argv[1]))
with folder.lock():
    for index in range(len(folder.outcomes()), 10_000):
        stored_runs.store(folder, index)
        print(index, flush=True)
"""
PACK = """
import sys
from pathlib import Path
import stored_runs
from labrun.store.folder import RunFolder
folder = RunFolder.open(Path(sys.argv[1]))
print("ready", flush=True)
folder.pack()
"""


def start(program: str, run: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    return subprocess.Popen(
        [sys.executable, "-c", program, str(run)], stdout=subprocess.PIPE, text=True, env=environment
    )


def kill_after(process: subprocess.Popen[str], delay_s: float) -> None:
    """Let it go on for a moment, then kill it without a chance to clean up."""
    try:
        process.wait(timeout=delay_s)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
    process.wait()


def assert_whole(path: Path, count: int) -> None:
    """All of the first `count` trials are there, bit for bit, and nothing else is found wrong."""
    folder = RunFolder.open(path)
    outcomes = folder.outcomes()
    assert folder.faults == []
    assert len(outcomes) >= count
    assert outcomes == {index: stored_runs.outcome(index) for index in range(len(outcomes))}
    run = open_run(path)
    for index in outcomes:
        stored_runs.assert_as_measured(run.signals(index)["wrench"], index)
    assert not list(path.glob("**/*.partial"))


def test_no_trial_that_was_acknowledged_is_lost_when_the_writer_is_killed(tmp_path):
    rng = np.random.default_rng(20)
    path = stored_runs.new_run(tmp_path).path
    acknowledged = 0
    for _ in range(5):
        process = start(WRITE, path)
        for _ in range(int(rng.integers(1, 6))):
            acknowledged = int(process.stdout.readline()) + 1
        kill_after(process, rng.uniform(0, 0.01))
        acknowledged += process.stdout.read().count("\n")
        assert_whole(path, acknowledged)


def test_nothing_is_lost_when_packing_is_killed(tmp_path):
    rng = np.random.default_rng(21)
    template = stored_runs.new_run(tmp_path)
    stored_runs.store_many(template, 25)
    template.journal.close()
    for attempt in range(5):
        path = tmp_path / f"copy{attempt}" / "fin" / template.path.name
        shutil.copytree(template.path, path)
        process = start(PACK, path)
        assert process.stdout.readline() == "ready\n"
        kill_after(process, rng.uniform(0, 0.2))
        assert_whole(path, 25)
        RunFolder.open(path).pack()
        assert_whole(path, 25)
        assert not (path / "trials").exists()


def die_at(step: int, path: Path, *, packing: bool) -> None:
    """Write or pack, and die just before the given call that changes the disk's directory or syncs it."""
    count = 0

    def dying(real):
        def call(*arguments, **named):
            nonlocal count
            count += 1
            if count == step:
                os._exit(9)
            return real(*arguments, **named)

        return call

    for owner, name in (
        (os, "fsync"),
        (os, "ftruncate"),
        (Path, "replace"),
        (Path, "rename"),
        (Path, "unlink"),
        (Path, "rmdir"),
    ):
        setattr(owner, name, dying(getattr(owner, name)))
    disk.write_all = dying(disk.write_all)
    folder = RunFolder(path)
    folder._known = {index: stored_runs.outcome(index) for index in range(3)}
    if packing:
        folder.pack()
    else:
        stored_runs.store(folder, 3)
    os._exit(0)


@pytest.mark.parametrize("packing", [False, True], ids=["storing", "packing"])
def test_death_before_any_single_step_leaves_all_earlier_trials(tmp_path, packing):
    template = stored_runs.new_run(tmp_path)
    stored_runs.store_many(template, 3)
    template.journal.close()
    finished = False
    step = 0
    while not finished:
        step += 1
        path = tmp_path / f"step{step}" / "fin" / template.path.name
        shutil.copytree(template.path, path)
        process = get_context("fork").Process(target=die_at, args=(step, path), kwargs={"packing": packing})
        process.start()
        process.join()
        finished = process.exitcode == 0
        assert_whole(path, 3)
    assert step > 4


def test_the_lock_of_a_killed_run_is_gone_with_it(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    process = start(WRITE, folder.path)
    process.stdout.readline()
    with pytest.raises(RigBusyError, match=f"process {process.pid}"), RunFolder(folder.path).lock():
        pass
    process.kill()
    process.wait()
    with RunFolder(folder.path).lock():
        pass
