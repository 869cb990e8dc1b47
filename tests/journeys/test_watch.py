"""A run in one terminal, watched from another."""

import json
import os
import pty
import select
import signal
import subprocess
import time
from pathlib import Path

import pytest
from forked_labrun import forked_programs

from labrun.app.watch import Watcher
from labrun.runner import RealClock

SWEEP = (
    "sweep", "fin-params", "--dry-run", "--json", "--seed", "7",
    "--set", "sweep.axes.b=[0]", "--set", "sweep.axes.a=[20, 30, 40, 50, 60]",
    "--set", "sweep.axes.f=[0.8, 1.0, 1.2, 1.4]", "--set", "trial.reference.every=10",
)  # fmt: skip
EXPECTED = 60 + 6 + 30


@pytest.fixture
def sweep(command, tmp_path):
    """Start a dry run in a process of its own; give it and its folder as soon as that is there."""
    with subprocess.Popen(
        [*command, *SWEEP], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        while not (result := list(tmp_path.glob("results/*/*/spec.toml"))):
            assert process.poll() is None, process.stderr.read().decode()
            time.sleep(0.01)
        yield process, result[0].parent
        if process.poll() is None:
            process.kill()


def _content(run: Path) -> dict[str, tuple[int, bytes]]:
    files = [path for path in run.rglob("*") if path.is_file()]
    return {str(path): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}


def test_a_dry_run_is_seen_from_its_first_trial_to_its_honest_best(sweep, labrun):
    process, run = sweep
    watcher = Watcher(run, RealClock())
    looks = [watcher.look()]
    while looks[-1].state != "finished":
        time.sleep(0.05)  # the run wants the processor, too
        looks.append(watcher.look())
        assert looks[-1].state in ("starting", "running", "finished")
    output, _ = process.communicate(timeout=60)
    result = json.loads(output)
    totals = [look.total for look in looks]
    assert totals == sorted(totals)
    assert any(0 < total < EXPECTED for total in totals), "the run was never seen half way"
    assert {look.expected for look in looks if look.total} == {EXPECTED}
    assert looks[-1].trials == result["trials"]
    assert looks[-1].honest_best.to_json() == result["best"]
    assert looks[-1].trace.index == EXPECTED - 1
    halfway = next(look for look in looks if look.total > 20)
    assert halfway.best is not None
    assert halfway.trace.channel == "wrench.torque_y"
    assert halfway.units["thrust"] == "N"
    before = _content(run)
    seen = labrun("watch", "fin-params", "--json").json
    assert seen["state"] == "finished"
    assert seen["trials"] == result["trials"]
    assert _content(run) == before, "watching wrote something"


def test_a_killed_run_is_found_dead_with_the_way_to_go_on(sweep, labrun):
    process, run = sweep
    watcher = Watcher(run, RealClock())
    while watcher.look().total < 10:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    before = _content(run)
    while (seen := watcher.look()).state == "running":
        time.sleep(0.05)
    assert seen.state == "dead"
    assert str(process.pid) in seen.reason
    text = labrun("watch", run, "--once").out
    assert "silent since" in text
    assert f"labrun resume {run}" in text.replace("\n", "")
    assert _content(run) == before, "watching wrote something"

    assert labrun("resume", run, "--json").code == 0
    finished = watcher.look()
    assert finished.state == "finished"
    assert finished.total == EXPECTED


def test_in_a_terminal_it_follows_the_run_and_ends_with_it(sweep, tmp_path):
    process, _ = sweep
    shown = _in_terminal(
        [str(forked_programs() / "labrun"), "watch", "fin-params", "--every", "0.1"], tmp_path
    )
    process.wait(timeout=60)
    assert "running" in shown
    assert "finished" in shown.rpartition("running")[2]
    assert "best so far" in shown


def test_ctrl_c_ends_the_watching_and_not_the_run(sweep, command, tmp_path):
    process, run = sweep
    shown = _in_terminal([*command, "watch", str(run)], tmp_path, interrupt_after="last event")
    assert "Traceback" not in shown
    watcher = Watcher(run, RealClock())
    ended_at = watcher.look().total
    while process.poll() is None and watcher.look().total <= ended_at:
        time.sleep(0.05)
    assert process.poll() in (None, 0)


def _in_terminal(command: list[str], cwd: Path, interrupt_after: str | None = None) -> str:
    """Run a command in a pseudo-terminal until it ends with 0, and return what it showed."""
    terminal, end = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120", "LINES": "40"}
    with subprocess.Popen(
        command, cwd=cwd, stdin=end, stdout=end, stderr=end, env=environment, start_new_session=True
    ) as process:
        os.close(end)
        shown = b""
        while True:
            if interrupt_after is not None and interrupt_after.encode() in shown:
                process.send_signal(signal.SIGINT)
                interrupt_after = None
            ready, _, _ = select.select([terminal], [], [], 0.2)
            if not ready and process.poll() is not None:
                break
            try:
                shown += os.read(terminal, 1 << 16) if ready else b""
            except OSError:  # the other end is closed
                break
        os.close(terminal)
    # Ctrl-C may cut a drawing in the middle of a character.
    text = shown.decode(errors="replace")
    assert process.returncode == 0, text
    return text
