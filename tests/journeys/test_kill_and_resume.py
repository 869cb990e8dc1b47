"""A night's run survives `kill -9` at any instant."""

import os
import signal
import subprocess
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

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


DESIGN = (
    "design", "swimmer", "--dry-run", "--json",
    "--set", "design.population=20", "--set", "design.stop.iterations=8", "--set", "leaders.repeats=5",
)  # fmt: skip


OVER = (
    "cmaes", "min-drag-pose", "--dry-run", "--json",
    "--set", "cmaes.population=4", "--set", "cmaes.reevaluate=1", "--set", "cmaes.stop.iterations=3",
    "--set", "leaders={count=2, repeats=2}",
)  # fmt: skip
EACH = (
    "cmaes", "fire-attachment", "--dry-run", "--json",
    "--set", 'cmaes.each.attachment=["broad", "short"]', "--set", "cmaes.population=4",
    "--set", "cmaes.reevaluate=1", "--set", "cmaes.stop.iterations=3", "--set", "leaders={count=2, repeats=2}",
)  # fmt: skip
TRACK = ("track", "force-control", "--dry-run", "--json", "--set", "trial.repeats=1")
GAIT = "{alpha_1=36, alpha_2=40, beta_1=20, beta_2=-18, f=1.4, phi=60}"
ASKED = (
    "run", "field-turn", "--dry-run", "--json",
    "--set", f"run.conditions=[{GAIT}]", "--set", "trial.duration_s=8",
)  # fmt: skip


def _run(folder: Path) -> Path | None:
    """Return the folder of the one run there is, once it is there."""
    result = list(folder.glob("results/*/*/spec.toml"))
    return result[0].parent if result else None


def _journal_size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.glob("results/*/*/journal.jsonl"))


def _completed(run: Path) -> dict[int, bytes]:
    return {int(path.stem): path.read_bytes() for path in run.glob("trials/[0-9]*.h5")}


def _killed(command: list[str], folder: Path, rng: np.random.Generator) -> bool:
    """Start a command and kill it; False if it ended by itself before.

    One time in four the instant is uniform over the first second of the process (imports, recovery, replay), else over
    the 0.4 s after its first line in the journal.
    """
    before = _journal_size(folder)
    early = rng.random() < 0.25
    deadline = time.monotonic() + rng.uniform(0, 1.0)
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        if not early:
            while process.poll() is None and _journal_size(folder) == before:
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


def _kill_again_and_again(
    first: list[str], go_on: list[str], folder: Path, kills: int, rng: np.random.Generator
) -> int:
    """Kill and resume a run until it is finished or has been killed so often; returns how often it was."""
    for count in range(kills):
        run = _run(folder)
        before = _completed(run) if run is not None else {}
        if not _killed(first if run is None else [*go_on, str(run)], folder, rng):
            return count
        if run is None or (run / "run.h5").exists():
            continue
        after = _completed(run)
        lost = [index for index, content in before.items() if after.get(index) != content]
        assert not lost, f"completed trials were lost: {lost}"
        for index in after:
            with h5py.File(run / "trials" / f"{index:06d}.h5") as file:
                assert len(file) > 0
    return kills


@pytest.mark.slow
def test_a_design_killed_at_random_instants_is_the_same_design(labrun, command, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    whole.mkdir()
    killed.mkdir()
    expected = labrun(*DESIGN, "--seed", "7", cwd=whole)
    assert expected.code == 0, expected.err
    rng = np.random.default_rng(3)
    first, go_on = [*command, *DESIGN, "--seed", "7"], [*command, "resume"]
    for _ in range(4):
        run = _run(killed)
        with subprocess.Popen(
            first if run is None else [*go_on, str(run)],
            cwd=killed,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        ) as process:
            generations = len(list(killed.glob("results/*/*/search/*")))
            while process.poll() is None and len(list(killed.glob("results/*/*/search/*"))) <= generations:
                time.sleep(0.01)
            time.sleep(rng.uniform(0, 0.3))
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)  # with the processes that simulate for it
    run = _run(killed)
    assert run is not None
    resumed = labrun("resume", run, "--json", cwd=killed)
    assert resumed.code == 0, resumed.err
    assert resumed.json["best"] == expected.json["best"]


@pytest.mark.parametrize(
    ("arguments", "most"),
    [
        pytest.param(SWEEP, 2, id="sweep"),
        pytest.param((*SEARCH, "--set", "cmaes.stop.iterations=3"), 2, id="search"),
        *(
            pytest.param(entry, most, id=f"{name}-{most}", marks=pytest.mark.slow)
            for name, entry, most in (
                ("sweep", SWEEP, 50), ("search", SEARCH, 50), ("over", OVER, 8), ("each", EACH, 8), ("asked", ASKED, 8),
                ("track", TRACK, 8),
            )
        ),
    ],
)  # fmt: skip
def test_runs_killed_at_random_instants_end_with_the_same_result(arguments, most, labrun, command, tmp_path):
    whole = tmp_path / "whole"
    whole.mkdir()
    expected = labrun(*arguments, "--seed", "7", cwd=whole)
    assert expected.code == 0, expected.err
    assert labrun("export", arguments[1], "--to", "csv", "--output", "trials.csv", cwd=whole).code == 0

    rng = np.random.default_rng(11)
    kills = 0
    while kills < most:
        folder = tmp_path / f"killed-after-{kills}"
        folder.mkdir()
        first, go_on = [*command, *arguments, "--seed", "7"], [*command, "resume"]
        kills += _kill_again_and_again(first, go_on, folder, most - kills, rng)
        run = _run(folder)
        result = (
            labrun("resume", run, "--json", cwd=folder)
            if run
            else labrun(*arguments, "--seed", "7", cwd=folder)
        )
        assert result.code == 0, result.err
        assert result.json["trials"] == expected.json["trials"]
        assert result.json["best"] == expected.json["best"]
        assert labrun("export", arguments[1], "--to", "csv", "--output", "trials.csv", cwd=folder).code == 0
        assert (folder / "trials.csv").read_text() == (whole / "trials.csv").read_text()
