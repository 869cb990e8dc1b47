"""A night's run survives `kill -9` at any instant."""

import os
import signal
import subprocess
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

KILLS = 50

SWEEP = (
    "sweep", "fin-params", "--dry-run", "--json",
    "--set", "sweep.axes.b=[0]", "--set", "sweep.axes.a=[30, 45, 60]", "--set", "sweep.axes.f=[0.8, 1.0, 1.2, 1.4]",
    "--set", "trial.reference.every=10",
)  # fmt: skip
SEARCH = (
    "cmaes", "turn-torque", "--dry-run", "--json",
    "--set", "cmaes.population=8", "--set", "cmaes.parents=4", "--set", "cmaes.stop.iterations=6",
    "--set", "trial.repeats=2", "--set", "leaders={count=2, repeats=2}",
)  # fmt: skip


def _kill_after_some_progress(command: list[str], cwd: Path, rng: np.random.Generator) -> bool:
    """Start a command, kill it within 0.4 s of its first journal line; False if it ended before."""
    before = _journal_size(cwd)
    with subprocess.Popen(command, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        while process.poll() is None and _journal_size(cwd) == before:
            time.sleep(0.005)
        deadline = time.monotonic() + rng.uniform(0, 0.4)
        while process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.001)
        if process.poll() is None:
            os.kill(process.pid, signal.SIGKILL)
            return True
        assert process.stderr is not None
        assert process.returncode == 0, process.stderr.read().decode()
        return False


def _journal_size(cwd: Path) -> int:
    return sum(path.stat().st_size for path in cwd.glob("results/*/*/journal.jsonl"))


def _completed(run: Path) -> dict[int, bytes]:
    return {int(path.stem): path.read_bytes() for path in run.glob("trials/[0-9]*.h5")}


@pytest.mark.parametrize("arguments", [SWEEP, SEARCH], ids=["sweep", "search"])
def test_a_run_killed_at_fifty_random_instants_ends_with_the_same_result(
    arguments, labrun, command, tmp_path
):
    whole = tmp_path / "whole"
    killed = tmp_path / "killed"
    whole.mkdir()
    killed.mkdir()
    expected = labrun(*arguments, "--seed", "7", cwd=whole)
    assert expected.code == 0, expected.err

    rng = np.random.default_rng(11)
    kills = 0
    started = False
    while kills < KILLS:
        again = [*command, "resume", "--json"] if started else [*command, *arguments, "--seed", "7"]
        runs = list(killed.glob("results/*/*/journal.jsonl"))
        before = _completed(runs[0].parent) if runs else {}
        if not _kill_after_some_progress(again, killed, rng):
            break
        kills += 1
        started = bool(list(killed.glob("results/*/*/spec.toml")))
        for run in {path.parent for path in killed.glob("results/*/*/journal.jsonl")}:
            after = _completed(run)
            if not (run / "run.h5").exists():
                lost = [index for index, content in before.items() if after.get(index) != content]
                assert not lost, f"completed trials were lost: {lost}"
            for index in after:
                with h5py.File(run / "trials" / f"{index:06d}.h5") as file:
                    assert len(file) > 0
    assert kills >= KILLS // 2, f"the run was too short to be killed often enough ({kills} kills)"

    result = labrun("resume", "--json", cwd=killed)
    if "finished" not in result.err:
        assert result.code == 0, result.err
        assert result.json["trials"] == expected.json["trials"]
        assert result.json["best"] == expected.json["best"]

    name = arguments[1]
    tables = [
        labrun("export", name, "--to", "csv", "--output", "t.csv", cwd=folder) for folder in (whole, killed)
    ]
    assert [table.code for table in tables] == [0, 0]
    assert (killed / "t.csv").read_text() == (whole / "t.csv").read_text()
