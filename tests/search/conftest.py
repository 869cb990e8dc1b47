from pathlib import Path

import pytest

from labrun.app.run import run as execute
from labrun.experiment import load_experiment
from labrun.runner import SilentProgress

TANK = """
title = "Thrust of a tail"
kind = "{kind}"
[rig]
scene = "caudal-tank"
[rig.devices.tail]
plugin = "arduino-servo"
port = "/dev/ttyACM0"
limits = {{ angle_deg = [-60, 60], speed_deg_s = 528 }}
[rig.devices.wrench]
plugin = "robotiq-ft300"
port = "/dev/ttyUSB0"
limits = {{ force_n = 300, torque_n_m = 30 }}
[gait]
plugin = "sine"
joints.tail = {{ offset_deg = "0", amplitude_deg = "a", frequency_hz = "f" }}
[trial]
cycles = 3
discard_cycles = 1
repeats = 2
settle = {{ until = "time", hold_s = 1 }}
tare = {{ duration_s = 0.5, devices = ["wrench"] }}
[objectives.thrust]
plugin = "cycle-mean"
channel = "wrench.force_x"
goal = "maximise"
[leaders]
count = 2
repeats = 3
"""
SWEEP = """
[sweep]
axes = { a = [30, 45, 60], f = [1.2, 1.4] }
"""
SEARCH = """
[cmaes]
population = 6
parents = 3
reevaluate = 1
where = ["a * f <= 70"]
stop = { iterations = 3 }
[cmaes.variables]
a = { from = 10, to = 60 }
f = { from = 0.8, to = 2.0 }
"""


class Recorder(SilentProgress):
    """Keeps what a person would have read."""

    def __init__(self):
        self.notes: list[str] = []
        self.bests: list[float] = []
        self.trials = 0
        self.expected = None

    def note(self, text):
        self.notes.append(text)

    def best(self, condition, value, unit):
        self.bests.append(value)

    def total(self, trials):
        self.expected = trials

    def trial(self, outcome, done, total, remaining_s):
        self.trials += 1


@pytest.fixture
def recorder():
    return Recorder()


@pytest.fixture
def write(tmp_path: Path):
    """Write an experiment file: "sweep" or "cmaes", with lines to add."""

    def make(kind: str, extra: str = "") -> Path:
        path = tmp_path / f"{kind}.toml"
        path.write_text(TANK.format(kind=kind) + (SWEEP if kind == "sweep" else SEARCH) + extra)
        return path

    return make


@pytest.fixture
def dry_run(tmp_path: Path):
    """Run an experiment file to its end, or to a limit, in simulated time."""

    def run(path: Path, *, limit=None, seed=5, results="results", progress=None, draw=False):
        return execute(
            load_experiment(path),
            results=tmp_path / results,
            dry_run=True,
            seed=seed,
            limit=limit,
            progress=progress,
            draw=draw,
        )

    return run
