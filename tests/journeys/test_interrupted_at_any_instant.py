"""A run that is asked to stop, once or often, at any instant, ends with one true sentence and goes on when asked to."""

import contextlib
import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

ARGUMENTS = (
    "sweep", "fin-params", "--dry-run", "--seed", "7",
    "--set", "sweep.axes.b=[0]", "--set", "sweep.axes.a=[30, 45, 60]", "--set", "sweep.axes.f=[0.8, 1.0, 1.2, 1.4]",
)  # fmt: skip
LONGEST_S = 4.0


def takes_signals(process: subprocess.Popen[str]) -> bool:
    """Tell whether the process has got as far as to handle SIGTERM; before, Python itself is starting."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


OWN_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""
"""Makes standard input the terminal that hangs up on the process when it is closed."""


def interrupt(
    command: list[str], folder: Path, number: int, rng: np.random.Generator
) -> subprocess.Popen[str]:
    """Start a run, send it a signal at a random instant, and then again and again until it has ended."""
    process = subprocess.Popen(
        [*command, *ARGUMENTS], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    while not takes_signals(process):
        time.sleep(0.005)
    time.sleep(rng.uniform(0.0, LONGEST_S))
    while process.poll() is None:
        process.send_signal(number)
        time.sleep(rng.uniform(0.0, 0.1))
    return process


def check(process: subprocess.Popen[str], folder: Path, number: int) -> None:
    _, err = process.communicate()
    assert "Traceback" not in err
    if process.returncode == 0:  # it had finished
        assert "run.h5" in [path.name for path in folder.glob("results/*/*/*")]
        return
    assert process.returncode == 128 + number, err
    assert err.count("interrupted by") == 1
    runs = list(folder.glob("results/*/*"))
    if runs:
        assert "before anything" not in err
        assert f"labrun resume {runs[0].relative_to(folder)}" in err


@pytest.mark.parametrize(
    ("name", "count"),
    [("SIGINT", 1), ("SIGTERM", 1)]
    + [pytest.param(name, 15, marks=pytest.mark.slow) for name in ("SIGINT", "SIGTERM", "SIGHUP")],
)
def test_a_run_that_is_asked_to_stop_again_and_again_ends_once(name, count, command, labrun, tmp_path):
    number = signal.Signals[name]
    rng = np.random.default_rng(number)
    for attempt in range(count):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        check(interrupt(command, folder, number, rng), folder, number)
        if list(folder.glob("results/*/*/spec.toml")):
            resumed = labrun("resume", "--json", cwd=folder)
            assert resumed.code == 0, resumed.err
            assert resumed.json["trials"]["done"] > 0


def test_a_closed_terminal_stops_the_run_and_keeps_its_trials(command, tmp_path):
    main, terminal = os.openpty()
    own = [command[0], "-c", OWN_TERMINAL, *command, *ARGUMENTS]
    process = subprocess.Popen(
        own, cwd=tmp_path, stdin=terminal, stdout=terminal, stderr=terminal,
        start_new_session=True,
    )  # fmt: skip
    os.close(terminal)
    os.set_blocking(main, False)
    while process.poll() is None and len(list(tmp_path.glob("results/*/*/trials/0*.h5"))) < 3:
        time.sleep(0.01)
        with contextlib.suppress(BlockingIOError):
            os.read(main, 65_536)
    os.close(main)
    assert process.wait(60) == 128 + signal.SIGHUP
    journal = next(tmp_path.glob("results/*/*/journal.jsonl")).read_text()
    assert '"interrupted"' in journal.splitlines()[-1]
