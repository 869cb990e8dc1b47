"""A rig of real drivers in front of emulators, with a session on a run folder."""

import copy
import threading
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from forked_labrun import forked_emulators

from labrun.experiment import Experiment
from labrun.runner import EmulatedBench, RealClock, Rig, Session, SilentProgress
from labrun.store import RunFolder

CLOCK = RealClock()

EXPERIMENT = """
title = "Tail in a tank"
kind = "run"
[rig]
scene = "caudal-tank"
[rig.devices.tail]
plugin = "arduino-servo"
port = "/dev/ttyACM0"
limits = { angle_deg = [-60, 60], speed_deg_s = 528 }
[rig.devices.wrench]
plugin = "robotiq-ft300"
port = "/dev/ttyUSB0"
limits = { force_n = 300, torque_n_m = 30 }
[gait]
plugin = "sine"
joints.tail = { offset_deg = 0, amplitude_deg = "a", frequency_hz = 1 }
[trial]
cycles = 3
repeats = 1
[run]
order = "as-listed"
conditions = [{ a = 20 }]
[objectives]
push = { plugin = "rms", channel = "wrench.torque_y" }
"""


def experiment_with(**changes: Any) -> Experiment:
    """Return the experiment with dotted keys changed (``__`` for a dot)."""
    table = copy.deepcopy(tomllib.loads(EXPERIMENT))
    for key, value in changes.items():
        *path, last = key.split("__")
        setdefault = table
        for part in path:
            setdefault = setdefault.setdefault(part, {})
        setdefault[last] = value
    return Experiment.model_validate(table)


class Watcher(SilentProgress):
    """Calls something once, a moment into a recording, from a thread of its own."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self._action: Callable[[], object] | None = None
        self._after_s = 0.0

    def when_recording(self, after_s: float, action: Callable[[], object]) -> None:
        """Do this, so long after the next recording begins."""
        self._after_s, self._action = after_s, action

    def phase(self, name: str) -> None:
        if name == "record" and self._action is not None:
            threading.Timer(self._after_s, self._action).start()
            self._action = None

    def note(self, text: str) -> None:
        self.notes.append(text)


class EmulatedLab:
    """An opened rig, its emulators, and a session."""

    def __init__(self, bench: EmulatedBench, experiment: Experiment, folder: RunFolder, seed: int) -> None:
        self.bench = bench
        self.experiment = experiment
        self.folder = folder
        self.watcher = Watcher()
        self.rig = Rig.build(experiment, clock=CLOCK, seed=seed, dry_run=False, emulated=bench)
        self.rig.open()
        self.session = Session(experiment, self.rig, folder, CLOCK, seed, self.watcher)

    def measure(self) -> list[Any]:
        """Measure the experiment's conditions; return the outcomes of the first."""
        assert self.experiment.run is not None
        return list(self.session.measure(self.experiment.run.conditions, order="as-listed")[0].outcomes)

    def events(self, device: str, event: str) -> list[dict[str, Any]]:
        """Return the emulator's lines of one kind."""
        return [line for line in self.bench.log(device) if line["event"] == event]

    def journal(self, event: str) -> list[dict[str, Any]]:
        """Return the run's journal lines of one kind."""
        return [line for line in self.folder.journal.events() if line["event"] == event]


@contextmanager
def emulated_lab(tmp_path: Path, *, seed: int = 1, **changes: Any) -> Iterator[EmulatedLab]:
    """Open a lab with changes to the experiment; everything ends with the block."""
    experiment = experiment_with(**changes)
    folder = RunFolder.create(tmp_path / "results", "tank", "title = 'x'", {"seed": seed})
    with forked_emulators(), EmulatedBench(experiment.rig.devices, experiment.rig.scene, seed=seed) as bench:
        lab = EmulatedLab(bench, experiment, folder, seed)
        try:
            yield lab
        finally:
            lab.rig.safe_stop()
            lab.rig.close()
