"""Two runs at once on one rig: the second is refused before anything of it connects; and what a rig needs to run."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from paddle_lab import EXPERIMENT, experiment_with

from labrun.app.run import connected
from labrun.app.run import run as execute
from labrun.devices import DeviceSettings, Port
from labrun.errors import PluginError, RigBusyError
from labrun.experiment import loads_experiment
from labrun.runner import RealClock, Rig, ports_of
from labrun.store import disk as rig_lock
from labrun.store import lock_ports


@pytest.fixture
def locks(tmp_path, monkeypatch):
    """Keep the locks of this test to itself."""
    monkeypatch.setattr(rig_lock, "lock_folder", lambda: tmp_path / "locks")
    return tmp_path / "locks"


def real_rig(**changes):
    """Return the paddle's rig as on hardware; nothing is connected."""
    return Rig.build(experiment_with(**changes), clock=RealClock(), seed=1, dry_run=False)


def test_a_second_run_on_a_rig_is_refused_and_connects_and_writes_nothing(tmp_path, locks):
    log = tmp_path / "opened.log"
    text = EXPERIMENT.replace(
        'plugin = "pond:Servo"', f'plugin = "pond:Servo"\nport = "/dev/null"\nopen_log = "{log}"'
    )
    loaded = loads_experiment(text, "paddle")
    first = Rig.build(loaded.experiment, clock=RealClock(), seed=1, dry_run=False)
    with connected(first):
        assert log.read_text().splitlines() == ["open tail"]
        with pytest.raises(RigBusyError, match=f"port /dev/null is in use by process {os.getpid()}"):
            execute(loaded, results=tmp_path / "results", dry_run=False, seed=1, draw=False)
        assert log.read_text().splitlines() == ["open tail"]
        assert not (tmp_path / "results").exists()
    with connected(Rig.build(loaded.experiment, clock=RealClock(), seed=1, dry_run=False)):
        assert log.read_text().splitlines() == ["open tail", "open tail"]


def test_a_dry_run_needs_no_port(locks):
    experiment = experiment_with(rig__devices__tail__port="/dev/null")
    from labrun.runner import SimulatedClock

    rig = Rig.build(experiment, clock=SimulatedClock(), seed=1, dry_run=True)
    with lock_ports(["/dev/null"]), connected(rig):
        pass


def test_every_port_and_host_of_a_device_counts():
    class Settings(DeviceSettings):
        host: str = "192.168.1.4"
        port: int = 30004
        motor: Port = "/dev/ttyUSB0"
        encoder: Port | None = "/dev/ttyUSB1"
        feet: tuple[Port, ...] = ("COM3", "COM4")
        spare: Port = ""
        name: str = "left"

    assert sorted(ports_of(Settings())) == ["/dev/ttyUSB0", "/dev/ttyUSB1", "192.168.1.4", "COM3", "COM4"]


def test_a_device_that_moves_without_an_emergency_stop_is_refused_on_hardware_and_only_there(lab, tmp_path):
    sledge = {"plugin": "pond:Sledge"}
    log = tmp_path / "opened.log"
    rig = real_rig(rig__devices__sledge=sledge, rig__devices__tail__open_log=str(log))
    with pytest.raises(
        PluginError, match=r"device sledge \(plugin 'pond:Sledge'\).*no emergency stop"
    ) as caught:
        rig.open()
    assert "emergency_stop(cls, name, settings)" in str(caught.value)
    assert not log.exists()
    assert "sledge" in lab(rig__devices__sledge=sledge).rig.devices


HANGING = """
import sys
sys.path.insert(0, sys.argv[1])
from paddle_lab import experiment_with
from labrun.runner import RealClock
from labrun.runner import Rig
experiment = experiment_with(rig__devices__tail__stop_log=sys.argv[2], rig__devices__tail__stop_hangs_s=60.0)
rig = Rig.build(experiment, clock=RealClock(), seed=1, dry_run=False)
rig.open()
rig.arm()
print(rig.safe_stop(), flush=True)
rig.safe_stop()
rig.disarm()
print("data is kept", flush=True)
rig.close()
"""


def test_a_stop_that_hangs_costs_no_data_and_the_watchdog_stops_the_device_afterwards(tmp_path):
    log = tmp_path / "stops.log"
    done = subprocess.run(
        [sys.executable, "-c", HANGING, str(Path(__file__).parent), str(log)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["['tail did not stop within 2 s']", "data is kept"]
    deadline = time.monotonic() + 20.0
    while "emergency_stop tail" not in log.read_text():
        assert time.monotonic() < deadline, "the watchdog did not stop the tail"
        time.sleep(0.02)
