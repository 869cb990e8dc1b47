"""A bench to run on, and an experiment to change piece by piece."""

import copy
import tomllib
from pathlib import Path

from labrun.experiment import Experiment
from labrun.runner import Rig, Session, SimulatedClock

EXPERIMENT = """
title = "Paddle"
kind = "sweep"
[rig]
scene = { plugin = "pond:Pond" }
[rig.devices.tail]
plugin = "pond:Servo"
limits = { angle_deg = [-60, 60], speed_deg_s = 600 }
[rig.devices.cell]
plugin = "pond:Cell"
limits = { force_n = 100 }
[gait]
plugin = "sine"
joints.tail = { offset_deg = 0, amplitude_deg = "a", frequency_hz = "f" }
[trial]
cycles = 3
discard_cycles = 1
repeats = 2
settle = { until = "quiet", channel = "cell.force_x", below = 0.02, hold_s = 1, timeout_s = 30 }
tare = { duration_s = 0.5 }
safe_pose_deg = { tail = 5 }
[sweep]
axes = { a = [10, 20], f = [1.0] }
[objectives]
thrust = { plugin = "rms", channel = "cell.force_x" }
"""


def merge(table, changes):
    """Lay dotted keys over a nested table."""
    merged = copy.deepcopy(table)
    for key, value in changes.items():
        *path, last = key.split(".")
        setdefault = merged
        for part in path:
            setdefault = setdefault.setdefault(part, {})
        if value is None:
            setdefault.pop(last, None)
        else:
            setdefault[last] = value
    return merged


def experiment_with(**changes):
    """Return the paddle experiment with dotted keys changed (``__`` for a dot); None removes a key."""
    dotted = {key.replace("__", "."): value for key, value in changes.items()}
    return Experiment.model_validate(merge(tomllib.loads(EXPERIMENT), dotted))


class Lab:
    """An opened dry-run rig with a session on a run folder."""

    def __init__(self, folder, experiment, *, seed=1, limit=None, progress=None):
        self.experiment = experiment
        self.folder = folder
        self.clock = SimulatedClock()
        self.rig = Rig.build(experiment, clock=self.clock, seed=seed, dry_run=True)
        self.rig.open()
        self.session = Session(experiment, self.rig, folder, self.clock, seed, progress, limit)

    def stops(self):
        """Return the lines of the servo's stop log."""
        log = self.rig.devices["tail"].settings.stop_log
        return Path(log).read_text().splitlines()
