"""Many emulated trials with a random fault on a random device every so often: what becomes of them.

    python benchmarks/soak.py [--trials 2000] [--minutes 60] [--every 30] [--seed 1]

Real drivers, real time, emulators in processes of their own: a Dynamixel with feedback and a force/torque sensor on a
fin in a tank, short trials with ``on_fault = "skip"``. Every `--every` seconds one fault strikes at a random moment of
a recording, lasts a moment, and ends. A fault that spoils a recording must fail or reject its trial; one that drivers
make good may leave it done. The script fails where a trial is lost or wrongly done, nothing happens for a minute, or
memory grows.
"""

import argparse
import faulthandler
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from measuring import machine, table

from labrun.errors import LabrunError
from labrun.experiment import Experiment
from labrun.runner import EmulatedBench, Interrupted, LimitReached, RealClock, Rig, Session, SilentProgress
from labrun.store import RunFolder, TrialOutcome

CLOCK = RealClock()
DURATION_S = 1.0
LASTS_S = 0.7
HANG_S = 60.0
GROWTH_MB = 50.0
_EXPERIMENT: dict[str, Any] = {
    "title": "Soak",
    "kind": "run",
    "rig": {
        "scene": "caudal-tank",
        "devices": {
            "tail": {
                "plugin": "dynamixel", "port": "/dev/ttyUSB1", "joints": {"tail": {"id": 1}}, "feedback_hz": 25,
                "limits": {"angle_deg": [-60, 60], "speed_deg_s": 528}, "watchdog_ms": 1000,
            },
            "wrench": {"plugin": "robotiq-ft300", "port": "/dev/ttyUSB0", "limits": {"force_n": 300}},
        },
    },
    "gait": {"plugin": "sine", "joints": {"tail": {"amplitude_deg": 30, "frequency_hz": 2}}},
    "trial": {"duration_s": DURATION_S, "on_fault": "skip", "max_lost_share": 0.3},
    "run": {"conditions": [{"a": 1}]},
    "objectives": {"push": {"plugin": "rms", "channel": "wrench.torque_y"}},
}  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """A fault of an emulator.

    `value` is what it is set to. `spoils` says whether a recording that it strikes cannot count.
    """

    device: str
    name: str
    value: Any = True
    spoils: bool = True

    def __str__(self) -> str:
        return f"{self.device}: {self.name}"


FAULTS = (
    Fault("tail", "restart", 1), Fault("tail", "unplug"), Fault("tail", "silence"), Fault("tail", "overcurrent"),
    Fault("tail", "watchdog", 1), Fault("tail", "corrupt", 3, spoils=False), Fault("tail", "error", 1, spoils=False),
    Fault("wrench", "unplug"), Fault("wrench", "silence"), Fault("wrench", "restart", 1), Fault("wrench", "saturate"),
    Fault("wrench", "garbage", 3, spoils=False), Fault("wrench", "fragment", spoils=False),
    Fault("wrench", "corrupt", 3, spoils=False),
)  # fmt: skip


@dataclass
class Soak(SilentProgress):
    """Brings faults about, and counts what becomes of the trials they strike."""

    bench: EmulatedBench
    every_s: float
    rng: np.random.Generator
    struck: dict[str, Counter[str]] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    trials: Counter[str] = field(default_factory=Counter)
    heard_s: float = field(default_factory=CLOCK.now)
    _due_s: float = 0.0
    _fault: Fault | None = None
    _timers: list[threading.Timer] = field(default_factory=list)

    def phase(self, text: str) -> None:
        """Bring the next fault about, if it is time for one and a recording begins."""
        self.heard_s = CLOCK.now()
        if text != "record" or CLOCK.now() < self._due_s:
            return
        self._due_s = CLOCK.now() + self.every_s
        fault = self._fault = FAULTS[int(self.rng.integers(len(FAULTS)))]
        # early enough that what it does lies inside the recording
        begin_s = float(self.rng.uniform(0.1, DURATION_S - 0.8))
        self._timers = [
            threading.Timer(begin_s, self.bench.inject, (fault.device, fault.name, fault.value)),
            threading.Timer(begin_s + LASTS_S, self.bench.clear, (fault.device, fault.name)),
        ]
        for timer in self._timers:
            timer.daemon = True
            timer.start()

    def trial(self, outcome: TrialOutcome, done: int, total: int | None, remaining_s: float | None) -> None:  # noqa: ARG002
        """Count a trial that was stored."""
        self.heard_s = CLOCK.now()
        self.trials[outcome.status] += 1
        fault, self._fault = self._fault, None
        if fault is None:
            if outcome.status != "done":
                self.struck.setdefault("none", Counter())[outcome.status] += 1
                sys.stderr.write(f"trial {outcome.index} without a fault: {outcome.reason}\n")
            return
        for timer in self._timers:
            timer.join()
        self.struck.setdefault(str(fault), Counter())[outcome.status] += 1
        if fault.spoils and outcome.status == "done":
            self.wrong.append(f"trial {outcome.index} is done although {fault}")


def resident_mb() -> float:
    """Return the memory of this process."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS:")).split()[1]) / 1000


def watch(soak: Soak) -> None:
    """End the process with the stacks of all threads when nothing has happened for `HANG_S`."""
    while True:
        CLOCK.sleep(1.0)
        if CLOCK.now() - soak.heard_s > HANG_S:
            faulthandler.dump_traceback()
            sys.stderr.write(f"nothing happened for {HANG_S:g} s: a hang\n")
            sys.stderr.flush()
            faulthandler.dump_traceback_later(0.1, exit=True)


def run(folder: Path, trials: int, minutes: float, every_s: float, seed: int) -> int:
    """Run the soak; return how the process ends."""
    table_of_trial: Mapping[str, Any] = {**_EXPERIMENT["trial"], "repeats": {"min": trials, "max": trials}}
    experiment = Experiment.model_validate({**_EXPERIMENT, "trial": table_of_trial})
    run_folder = RunFolder.create(folder, "soak", "title = 'soak'", {"seed": seed})
    ends_s, ended_early, memory_mb = CLOCK.now() + 60.0 * minutes, 0, 0.0
    with EmulatedBench(experiment.rig.devices, experiment.rig.scene, seed=seed) as bench:
        soak = Soak(bench, every_s, np.random.default_rng(seed))
        threading.Thread(target=watch, args=(soak,), daemon=True).start()
        while soak.trials.total() < trials and CLOCK.now() < ends_s:
            limit = min(20, trials - soak.trials.total())
            try:
                with Rig.build(experiment, clock=CLOCK, seed=seed, dry_run=False, emulated=bench) as rig:
                    part = Session(experiment, rig, RunFolder.open(run_folder.path), CLOCK, seed, soak, limit)
                    part.measure([{"a": 1.0}])
            except Interrupted:
                break
            except LabrunError as error:  # the run ended, as it may: labrun resume goes on
                ended_early += 1
                sys.stderr.write(f"run ended: {error}\n")
            except LimitReached:  # as --limit does: labrun resume goes on
                continue
            finally:
                memory_mb = memory_mb or resident_mb()
    outcomes = RunFolder.open(run_folder.path).outcomes()
    lost = soak.trials.total() - len(outcomes)
    grown_mb = resident_mb() - memory_mb
    kinds = ("done", "rejected", "failed")
    rows = [[name, *(str(count[kind]) for kind in kinds)] for name, count in sorted(soak.struck.items())]
    print(table(["fault", *kinds], rows))
    counts = ", ".join(f"{soak.trials[kind]} {kind}" for kind in kinds)
    print(f"\n{soak.trials.total()} trials: {counts}; {lost} lost, {len(soak.wrong)} wrongly done")
    print(f"runs that ended and were resumed: {ended_early}; memory grew by {grown_mb:.1f} MB")
    for text in soak.wrong:
        print(text)
    return 1 if lost or soak.wrong or grown_mb > GROWTH_MB else 0


def main() -> int:
    """Read the options and run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--every", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(machine("labrun", "numpy"))
    with tempfile.TemporaryDirectory() as folder:
        return run(Path(folder), options.trials, options.minutes, options.every, options.seed)


if __name__ == "__main__":
    sys.exit(main())
