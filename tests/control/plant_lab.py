"""The plant bench with a run folder, to change piece by piece."""

import json
import tomllib
from pathlib import Path

from labrun.control.closed_loop import ClosedLoopRecorder
from labrun.experiment import Experiment
from labrun.runner import Rig, Session, SimulatedClock
from labrun.store import RunFolder, open_run

EXPERIMENT = """
title = "Two axes"
kind = "track"
[rig]
scene = { plugin = "plant_bench:Plant" }
[rig.devices.servos]
plugin = "plant_bench:Servos"
limits = { angle_deg = [-45, 45], speed_deg_s = 200 }
[rig.devices.eye]
plugin = "plant_bench:Eye"
[gait]
plugin = "hold"
joints.roll = { angle_deg = "u" }
joints.pitch = { angle_deg = "v" }
[trial]
duration_s = 4
[track]
rate_hz = 20
conditions = [{ controller = "P" }]
[track.loops.roll]
drives = "u"
range = [-30, 30]
slew_per_s = 100
reference = { plugin = "constant", value = 10 }
feedback = { plugin = "latest", channel = "eye.roll", unit = "deg" }
controllers.P = { plugin = "pid", p = 0.4, output = "increment" }
[track.loops.pitch]
drives = "v"
range = [-30, 30]
slew_per_s = 100
reference = { plugin = "step", before = 0, after = -5, at_s = 2 }
feedback = { plugin = "latest", channel = "eye.pitch", unit = "deg" }
controllers.P = { plugin = "pid", i = 2 }
"""


def experiment_with(**changes):
    """Return the experiment with dotted keys changed (``__`` for a dot); None removes a key."""
    data = tomllib.loads(EXPERIMENT)
    for key, value in changes.items():
        *path, last = key.split("__")
        setdefault = data
        for part in path:
            setdefault = setdefault.setdefault(part, {})
        if value is None:
            setdefault.pop(last, None)
        else:
            setdefault[last] = value
    return Experiment.model_validate_json(json.dumps(data))


class PlantLab:
    """An opened dry-run rig, on a clock of choice, with a session that closes the loops."""

    def __init__(self, folder: Path, *, clock=None, seed=1, **changes):
        self.experiment = experiment_with(**changes)
        self.folder = RunFolder.create(folder, "two-axes", "title = 'x'", {"seed": seed})
        self.clock = clock or SimulatedClock()
        self.rig = Rig.build(self.experiment, clock=self.clock, seed=seed, dry_run=True)
        self.rig.open()
        recorder = ClosedLoopRecorder(self.experiment, self.rig)
        self.session = Session(self.experiment, self.rig, self.folder, self.clock, seed, recorder=recorder)

    def run(self):
        """Measure every condition of the file; return the outcomes in their order."""
        measured = self.session.measure(self.experiment.track.conditions, order="as-listed")
        return [outcome for item in measured for outcome in item.outcomes]

    def stream(self, index=0, device="loop"):
        """Return what one device, or the loops, recorded in a trial."""
        with open_run(self.folder.path) as run:
            return run.signals(index)[device]

    def command(self, index=0):
        """Return the motion that was really sent in a trial."""
        with open_run(self.folder.path) as run:
            return run.command(index)
