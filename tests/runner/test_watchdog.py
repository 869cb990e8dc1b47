"""The watchdog stops the actuators when the runner dies or hangs; in real time, in processes of their own."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest

from labrun.devices.processes.watchdog import Stoppable, stop_everything
from labrun.errors import DeviceError

RUNNER = """
    import sys
    sys.path.insert(0, {here!r})
    from pathlib import Path
    from conftest import experiment_with
    from labrun.runner import RealClock
    from labrun.runner import Rig
    from labrun.runner import Session
    from labrun.store.folder import RunFolder

    experiment = experiment_with(
        rig__devices__tail__stop_log={log!r},
        rig__watchdog_s=2.0,
        **{changes!r},
        trial__settle=None,
        trial__tare=None,
        trial__repeats=1,
    )
    clock = RealClock()
    folder = RunFolder.create(Path({results!r}), "paddle", "t = 1", {{}})
    with Rig.build(experiment, clock=clock, seed=1, dry_run=False) as rig:
        session = Session(experiment, rig, folder, clock, 1)
        print("open", flush=True)
        session.measure([{{"a": 10, "f": 1.0}}])
    print("closed", flush=True)
"""


@pytest.fixture
def runner(tmp_path):
    """Return a function that starts a runner on the paddle's own driver, with its log of stops."""
    started = []

    def start(**changes):
        log = tmp_path / "stops.log"
        code = textwrap.dedent(RUNNER).format(
            here=str(Path(__file__).parent),
            log=str(log),
            results=str(tmp_path / "results"),
            changes={"trial__cycles": 60, **changes},
        )
        process = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        started.append(process)
        assert process.stdout.readline() == b"open\n", process.stderr.read().decode()
        return process, log

    yield start
    for process in started:
        process.kill()
        process.communicate()


def wait_for(condition, timeout_s=20.0):
    """Wait until something holds."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "nothing happened in time"
        time.sleep(0.02)


def lines(log):
    """Return the log so far."""
    return log.read_text().splitlines() if log.exists() else []


def stopped(log, pid):
    """Tell whether another process than the runner has stopped the tail."""
    stops = [line.split() for line in lines(log) if line.startswith("emergency_stop tail")]
    return any(int(stop[2]) != pid for stop in stops)


def test_after_kill_9_the_watchdog_stops_the_actuators(runner):
    process, log = runner()
    wait_for(lambda: lines(log).count("follow tail") >= 1)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    wait_for(lambda: stopped(log, process.pid))


def test_a_runner_that_hangs_is_killed_first_and_then_the_actuators_are_stopped(runner):
    process, log = runner(rig__devices__tail__hang_after_s=1.0, rig__devices__tail__hang_holding=True)
    assert process.wait(timeout=30) == -signal.SIGKILL
    wait_for(lambda: stopped(log, process.pid))
    assert b"the driver of tail hangs" in process.stderr.read()
    assert not any(line.startswith("safe_stop") for line in lines(log))


NO_ACTUATOR = {
    "rig__devices__tail": None,
    "gait": {"plugin": "hold"},
    "trial__safe_pose_deg": None,
    "trial__cycles": None,
    "trial__duration_s": 60,
    "trial__discard_cycles": None,
}


@pytest.mark.parametrize("bench", [{}, NO_ACTUATOR], ids=["with an actuator", "without one"])
def test_a_sensor_whose_read_hangs_is_named_and_the_trial_is_kept(runner, bench):
    process, log = runner(**{"rig__devices__cell__hang_after_s": 1.0, **bench})
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 1
    assert b"device cell: its read() has not returned for" in errors
    assert not any(line.startswith("emergency_stop") for line in lines(log))


def test_on_a_rig_without_actuator_a_sensor_that_hangs_for_good_is_named_by_the_watchdog(runner):
    process, _ = runner(
        **{"rig__devices__cell__hang_after_s": 1.0, "rig__devices__cell__hang_holding": True, **NO_ACTUATOR}
    )
    _, errors = process.communicate(timeout=30)
    assert process.returncode == -signal.SIGKILL
    assert b"the driver of cell hangs" in errors


def test_a_runner_that_was_stopped_by_the_system_counts_as_hanging(runner):
    process, log = runner()
    wait_for(lambda: lines(log).count("follow tail") >= 1)
    os.kill(process.pid, signal.SIGSTOP)
    assert process.wait(timeout=30) == -signal.SIGKILL
    wait_for(lambda: stopped(log, process.pid))


def test_after_a_regular_end_the_watchdog_leaves_quietly(runner):
    process, log = runner(trial__cycles=2)
    output, _ = process.communicate(timeout=30)
    assert output == b"closed\n"
    assert process.returncode == 0
    assert not any(line.startswith("emergency_stop") for line in lines(log))


def test_ctrl_c_reaches_the_runner_and_not_the_watchdog(runner):
    process, log = runner()
    wait_for(lambda: lines(log).count("follow tail") >= 1)
    os.kill(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert b"interrupted by Ctrl-C" in errors
    assert any(line == f"safe_stop tail {process.pid}" for line in lines(log))
    assert not any(line.startswith("emergency_stop") for line in lines(log))


class Servo:
    """A servo whose port another process holds for the first few attempts to stop it."""

    def __init__(self, attempts_refused):
        self.attempts_refused = attempts_refused

    def emergency_stop(self, name, settings):
        if self.attempts_refused:
            self.attempts_refused -= 1
            raise DeviceError(name, "another program holds /dev/ttyUSB0")


class HangingServo:
    """A servo whose stop does not return."""

    def emergency_stop(self, name, settings):
        threading.Event().wait()


def test_a_port_that_a_dying_runner_still_holds_is_tried_again_until_it_is_free():
    servo = Stoppable("tail", Servo(attempts_refused=3), None)
    assert stop_everything([servo], "the runner died") == ["labrun watchdog: the runner died; stopped tail"]


def test_a_stop_that_hangs_or_fails_keeps_no_other_actuator_moving(monkeypatch):
    monkeypatch.setattr("labrun.devices.processes.watchdog._HANGING_S", 0.1)
    devices = {
        "left": HangingServo(),
        "right": Servo(attempts_refused=1000),
        "tail": Servo(attempts_refused=0),
    }
    left, right, tail = stop_everything(
        [Stoppable(name, servo, None) for name, servo in devices.items()], "the runner died", patience_s=0.1
    )
    assert left.endswith("could not stop left: its emergency_stop() does not return")
    assert "could not stop right: DeviceError: device right: another program holds" in right
    assert tail.endswith("stopped tail")


def test_the_watchdog_imports_nothing_heavy():
    code = (
        "import sys, labrun.devices.processes.watchdog as w;"
        "w.load_stoppable('tail', 'pond:Servo', {});"
        "print([m for m in ('scipy', 'numba', 'matplotlib', 'h5py', 'cma') if m in sys.modules])"
    )
    here = str(Path(__file__).parent)
    result = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": here}, capture_output=True, check=True
    )
    assert result.stdout.strip() == b"[]"
