"""What takes long, or a person, or a solver, survives `kill -9`: a hinge's life, strips set by hand, a solver's run."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

LIFE = (
    "run", "hinge-life", "--emulate", "--seed", "1",
    "--set", 'run.conditions=[{layup="polyester",specimen=1,range=120}]',
    "--set", 'trial.until.when="cycle > 1e6"', "--set", "trial.until.max_cycles=7",
)  # fmt: skip
STRIPS = ("run", "polyester-tensile", "--dry-run", "--seed", "3", "--json")
SOLVER = """
import pathlib, sys, time
with open("computed.txt", "a") as log:
    print(sys.argv[1], file=log)
time.sleep(1.0 if sys.argv[1] == "60" else 0.0)
pathlib.Path(sys.argv[2]).write_text(f"equal_limit,opposite_limit\\n0.{sys.argv[1]},1.{sys.argv[1]}\\n")
"""
RUN_SOLVER = (
    "run", "curved-beam-fea", "--json",
    "--set", 'rig.devices.fea.run=["python","solver.py","{theta_deg}","{output}"]',
    "--set", "run.conditions=[{theta_deg=30},{theta_deg=60},{theta_deg=90}]",
    "--set", 'units={theta_deg="deg"}',
)  # fmt: skip


def _killed_when(command: list[str], folder: Path, ready: Callable[[], bool]) -> None:
    """Start a command, and kill it as soon as something is so."""
    with subprocess.Popen(
        command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        deadline = time.monotonic() + 120.0
        while not ready():
            assert process.poll() is None, "it ended before it could be killed"
            assert time.monotonic() < deadline
            time.sleep(0.005)
        os.kill(process.pid, signal.SIGKILL)


def _cycles(folder: Path) -> list[float]:
    """Return the peak torques of the cycles on disk."""
    lines = [
        line for log in folder.glob("results/*/*/cycles/*.jsonl") for line in log.read_text().splitlines()
    ]
    whole = [json.loads(line) for line in lines if line.endswith("}")]
    return [loads["values"]["peak_torque"] for loads in whole if loads["event"] == "cycle"]


@pytest.mark.slow
def test_a_hinges_trial_killed_in_its_fifth_cycle_goes_on_with_the_cycles_on_disk(labrun, command, tmp_path):
    assert labrun("init").code == 0
    _killed_when([*command, *LIFE], tmp_path, lambda: len(_cycles(tmp_path)) >= 4)
    before = _cycles(tmp_path)
    assert len(before) >= 4

    resumed = labrun("resume", "--json")
    assert resumed.code == 0, resumed.err
    assert resumed.json["trials"]["done"] == 1
    read = """
import labrun
cycles = labrun.open("hinge-life").signals("cycles", trial=0)
print(cycles.peak_torque.values.tolist())
"""
    result = subprocess.run(
        [*command[:-2], "-c", read], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    torques = json.loads(result.stdout)
    assert len(torques) == 7
    assert torques[: len(before)] == pytest.approx(before)


@pytest.mark.slow
def test_strips_mounted_by_hand_are_the_same_strips_after_a_kill(labrun, command, tmp_path):
    (whole := tmp_path / "whole").mkdir()
    (broken := tmp_path / "broken").mkdir()
    expected = labrun(*STRIPS, cwd=whole)
    assert expected.code == 0, expected.err
    _killed_when(
        [*command, *STRIPS], broken, lambda: len([*broken.glob("results/*/*/trials/[0-9]*.h5")]) >= 3
    )
    resumed = labrun("resume", "--json", cwd=broken)
    assert resumed.code == 0, resumed.err
    assert resumed.json["trials"] == expected.json["trials"]
    for folder in (whole, broken):
        done = labrun("export", "polyester-tensile", "--to", "csv", "--output", "trials.csv", cwd=folder)
        assert done.code == 0, done.err
    assert (broken / "trials.csv").read_text() == (whole / "trials.csv").read_text()


@pytest.mark.slow
def test_a_killed_solver_run_computes_only_what_was_not_done(labrun, command, tmp_path):
    (tmp_path / "solver.py").write_text(SOLVER)
    computed = tmp_path / "computed.txt"
    _killed_when(
        [*command, *RUN_SOLVER],
        tmp_path,
        lambda: computed.exists() and computed.read_text().splitlines()[1:] == ["60"],
    )
    resumed = labrun("resume", "--json")  # at once: the killed runner's solver still computes
    assert resumed.code == 0, resumed.err
    assert resumed.json["trials"]["done"] == 3
    assert computed.read_text().split() == ["30", "60", "60", "90"]
    shown = labrun("export", "curved-beam-fea", "--to", "csv", "--output", "trials.csv")
    assert shown.code == 0, shown.err
    assert all(limit in (tmp_path / "trials.csv").read_text() for limit in ("0.3", "0.6", "0.9"))
    left = [*tmp_path.glob("solver/**/*.partial-*.csv")]
    assert len(left) <= 1, left  # of the solver that nobody waits for; the next for that load takes it away
