"""The emulator against a client that was written without knowledge of it."""

import importlib.util
import json
import os
import subprocess
import sys

import pytest
from emulated import emulated

CLIENT = """
import json, sys, time
from dashboard_client import DashboardClient
from rtde_receive import RTDEReceiveInterface
host = sys.argv[1]
names = ["timestamp", "actual_TCP_pose", "speed_scaling", "robot_mode", "safety_mode", "runtime_state"]
receive = RTDEReceiveInterface(host, 125.0, names)
first = receive.getTimestamp()
time.sleep(0.5)
dashboard = DashboardClient(host)
dashboard.connect()
told = {
    "pose": receive.getActualTCPPose(),
    "seconds": receive.getTimestamp() - first,
    "scaling": receive.getSpeedScaling(),
    "robot_mode": receive.getRobotMode(),
    "safety_mode": receive.getSafetyMode(),
    "robotmode": dashboard.robotmode(),
    "version": dashboard.polyscopeVersion(),
    "serial": dashboard.getSerialNumber(),
    "running": dashboard.running(),
}
dashboard.disconnect()
receive.disconnect()
print(json.dumps(told))
"""


@pytest.mark.skipif(importlib.util.find_spec("rtde_receive") is None, reason="ur_rtde is not installed")
def test_an_independent_client_reads_the_emulated_arm():
    # The client's ports are fixed, so that the emulator needs an address of its own: one of this process.
    number = os.getpid()
    address = f"127.{2 + (number >> 16) % 200}.{(number >> 8) % 256}.{1 + number % 254}"
    with emulated("ur5", {"host": address}, name="arm", faults={"e-series": True}) as bench:
        assert bench.driver._settings.host == address
        done = subprocess.run(
            [sys.executable, "-c", CLIENT, address], capture_output=True, text=True, timeout=30, check=False
        )
    assert done.returncode == 0, done.stderr
    loads = json.loads(done.stdout.splitlines()[-1])
    assert loads["pose"] == pytest.approx([-0.35, -0.4, 0.3, 0.0, 3.14, 0.0], abs=1e-3)
    assert 0.2 < loads["seconds"] < 5.0
    assert (loads["scaling"], loads["robot_mode"], loads["safety_mode"]) == (1.0, 7, 1)
    assert "RUNNING" in loads["robotmode"]
    assert "5.11.1" in loads["version"]
    assert loads["serial"].isdigit()
    assert loads["running"] is False
