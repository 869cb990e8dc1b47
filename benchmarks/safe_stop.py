"""How long it takes from what ends a run to the stop of each actuator, as the actuators' emulators witness it.

    python benchmarks/safe_stop.py [--repeats 5] [--actuators arduino-servo,dynamixel,ur5]

Real drivers, real time, emulators in processes of their own. Each repeat starts a long motion of one actuator beside
a force sensor, and a second into it one thing happens:

    Ctrl-C        SIGINT to the process that runs the trial
    exception     the sensor's driver raises
    lost sensor   the sensor is unplugged
    force limit   a sample beyond the sensor's limit arrives
    dead runner   the process is killed with SIGKILL: its watchdog, or the device's own, stops the actuator
    hung runner   the process is stopped with SIGSTOP: the device's own watchdog stops the actuator

The figure is the time from then (for the force limit: from the receipt of the sample) to the emulator's stop.
"""

import argparse
import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from measuring import machine, table

from labrun.devices import Samples
from labrun.errors import LabrunError
from labrun.experiment import Experiment
from labrun.runner import EmulatedBench, RealClock, Rig, Session, SilentProgress
from labrun.store import RunFolder

INSIDE = ("Ctrl-C", "exception", "lost sensor", "force limit")
OUTSIDE = ("dead runner", "hung runner")
SOON_S = 1.0
_WRENCH = {"plugin": "robotiq-ft300", "port": "/dev/ttyUSB0", "limits": {"force_n": 300.0}}
_SINE = {"plugin": "sine", "joints": {"tail": {"amplitude_deg": 30, "frequency_hz": 1}}}
_JOINT_LIMITS = {"angle_deg": [-60.0, 60.0], "speed_deg_s": 528.0}
_TRIAL: dict[str, Any] = {"duration_s": 60}
_RIGS: dict[str, dict[str, Any]] = {
    "arduino-servo": {
        "scene": "caudal-tank",
        "device": {
            "plugin": "arduino-servo", "port": "/dev/ttyACM0", "limits": _JOINT_LIMITS, "joints": {"tail": {}},
        },
        "gait": _SINE,
        "trial": _TRIAL,
    },
    "dynamixel": {
        "scene": "caudal-tank",
        "device": {
            "plugin": "dynamixel", "port": "/dev/ttyUSB1", "limits": _JOINT_LIMITS, "joints": {"tail": {"id": 1}},
        },
        "gait": _SINE,
        "trial": _TRIAL,
    },
    "ur5": {
        "scene": "fire-tank",
        "device": {
            "plugin": "ur5", "host": "192.168.1.2", "limits": {"travel_m": [0.0, 0.7], "speed_m_s": 0.1},
        },
        "beside": {"plugin": "dynamixel", "port": "/dev/ttyUSB1", "joints": {"tail": {"id": 5}}},
        "gait": {"plugin": "hold", "joints": {"tail": {"angle_deg": 0}}},
        "trial": {
            "duration_s": 20,
            "carriage": {"device": "actuator", "from_m": 0.0, "to_m": 0.7, "speed_m_s": 0.03},
        },
    },
}  # fmt: skip


def experiment(actuator: str) -> dict[str, Any]:
    """Return an experiment that moves one actuator for long."""
    rig = _RIGS[actuator]
    still = {"still": rig["beside"]} if "beside" in rig else {}
    return {
        "title": f"Stopping {actuator}",
        "kind": "run",
        "rig": {"scene": rig["scene"], "devices": {"actuator": rig["device"], "wrench": _WRENCH, **still}},
        "gait": rig["gait"],
        "trial": rig["trial"],
        "run": {"conditions": [{"number": 1}]},
        "objectives": {"push": {"plugin": "rms", "channel": "wrench.torque_y"}},
    }


class Starter(SilentProgress):
    """Does something a moment into the recording, from a thread of its own."""

    def __init__(self, action: Callable[[], object]) -> None:
        self._action = action

    def phase(self, text: str) -> None:
        """Begin to count when recording begins."""
        if text == "record":
            threading.Timer(SOON_S, self._action).start()


def stop_after(lines: list[dict[str, Any]], moment_s: float) -> float:
    """Return the time from a moment to the first stop or expired watchdog after it, s; infinite without one."""
    stops = [line["time_s"] for line in lines if line["event"] in ("stop", "watchdog")]
    return min((time_s - moment_s for time_s in stops if time_s >= moment_s), default=float("inf"))


def inside(actuator: str, cause: str, folder: Path) -> float:
    """Run a trial in this process, have it end by a cause, and return the time to the stop, s."""
    spec = Experiment.model_validate(experiment(actuator))
    run = RunFolder.create(folder, "stop", "title = 'stop'", {"seed": 1})
    happened: list[float] = []
    with EmulatedBench(spec.rig.devices, spec.rig.scene, seed=1) as bench:
        rig = Rig.build(spec, clock=RealClock(), seed=1, dry_run=False, emulated=bench)
        read = rig.sensors["wrench"].read

        def spoiled() -> Samples:
            block = read()
            if not wanted or not len(block):
                return block
            if cause == "exception":
                happened.append(time.monotonic())
                raise ZeroDivisionError("a driver with a bug")
            happened.append(float(block.host_time_s[-1]))
            return Samples(block.device_time_s, block.host_time_s, block.values + 1000.0)

        def happen() -> None:
            if cause in ("exception", "force limit"):
                wanted.append(True)
                return
            happened.append(time.monotonic())
            if cause == "Ctrl-C":
                os.kill(os.getpid(), signal.SIGINT)
            else:
                bench.inject("wrench", "unplug")

        wanted: list[bool] = []
        rig.sensors["wrench"].read = spoiled  # type: ignore[method-assign]
        with rig:
            session = Session(spec, rig, run, rig.clock, 1, Starter(happen))
            with contextlib.suppress(LabrunError):
                session.measure(spec.run.conditions if spec.run is not None else [])
            return stop_after(bench.log("actuator"), happened[0])


def outside(actuator: str, cause: str, folder: Path) -> float:
    """Run a trial in a process of its own, kill or freeze that, and return the time to the stop, s."""
    import tomli_w

    file = folder / "stop.toml"
    file.write_text(tomli_w.dumps(experiment(actuator)))
    command = [
        sys.executable,
        "-m",
        "labrun",
        "run",
        str(file),
        "--emulate",
        "--results",
        str(folder / "results"),
    ]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as runner:
        log = wait_for_recording(folder)
        time.sleep(SOON_S)
        happened_s = time.monotonic()
        runner.send_signal(signal.SIGKILL if cause == "dead runner" else signal.SIGSTOP)
        time.sleep(3.0)
        lines = [json.loads(line) for line in log.read_text().splitlines()]
        runner.kill()
    return stop_after(lines, happened_s)


def wait_for_recording(folder: Path) -> Path:
    """Wait until the run's trial is being recorded; return the log of the actuator's emulator."""
    deadline_s = time.monotonic() + 60
    while time.monotonic() < deadline_s:
        for journal in folder.glob("results/*/*/journal.jsonl"):
            if '"record"' in journal.read_text():
                return journal.parent / "emulated" / "actuator.jsonl"
        time.sleep(0.02)
    raise SystemExit("no recording began within a minute")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--actuators", default=",".join(_RIGS))
    given = parser.parse_args()
    print(machine("pyserial"))
    rows = []
    for actuator in given.actuators.split(","):
        for cause in (*INSIDE, *OUTSIDE):
            measure = inside if cause in INSIDE else outside
            results = []
            for _ in range(given.repeats):
                with tempfile.TemporaryDirectory() as scratch:
                    results.append(1e3 * measure(actuator, cause, Path(scratch)))
            rows.append([actuator, cause, f"{statistics.median(results):.1f}", f"{max(results):.1f}"])
            print(*rows[-1], flush=True)
    print(table(["actuator", "cause", "median (ms)", "worst (ms)"], rows))


if __name__ == "__main__":
    main()
