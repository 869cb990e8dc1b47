"""Peak memory of a 10-hour run with a 7 kHz six-axis sensor, packing included.

    python benchmarks/memory.py [--hours 10] [--trial-minutes 10] [--folder .]

The real runner, store and packing, in simulated time: the shipped stand-in for an ATI Net F/T box at 7000
samples/s, on a bench with hardly any physics (plain_bench.py), in trials of `--trial-minutes` until `--hours`
of recording are on disk; each trial has a mean and an RMS as objectives. `--hours 1 --trial-minutes 60` makes
one trial of an hour. Then everything is packed into run.h5 and verified. Ten hours are 252
million samples, 18 GB; trial files and run.h5 are on the disk together for a moment, so 41 GB must be free at
`--folder`. It takes five to ten minutes. Everything is removed afterwards.

The peak is the kernel's (ru_maxrss) and counts the whole process: Python, numba, HDF5 and its caches. It is
shown as the run grows, so that one sees whether it goes with length. Goal: under 500 MB (1e6 bytes).
"""

import argparse
import shutil
import tempfile
import tomllib
from pathlib import Path

from measuring import Stopwatch, machine, peak_mb, table

from labrun.experiment import Experiment
from labrun.runner import Rig, Session, SimulatedClock
from labrun.store import RunFolder

GOAL_MB = 500.0
RATE_HZ = 7000.0
BYTES_A_SAMPLE = 9 * 8
TEXT = """
title = "Hours of force"
kind = "sweep"
[rig]
scene = { plugin = "plain_bench:PlainBench" }
[rig.devices.tail]
plugin = "arduino-servo"
port = "/dev/ttyACM0"
limits = { angle_deg = [-60, 60], speed_deg_s = 528 }
[rig.devices.wrench]
plugin = "ati-netft"
host = "192.168.1.1"
rate_hz = 7000
[gait]
plugin = "hold"
joints.tail = { angle_deg = "a" }
[trial]
duration_s = DURATION
[sweep]
axes = { a = [1] }
[objectives]
thrust = { plugin = "mean", channel = "wrench.force_x" }
ripple = { plugin = "rms", channel = "wrench.force_x" }
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=10.0)
    parser.add_argument("--trial-minutes", type=float, default=10.0)
    parser.add_argument("--folder", type=Path, default=Path())
    arguments = parser.parse_args()
    duration_s = 60 * arguments.trial_minutes
    trials = round(3600 * arguments.hours / duration_s)
    needed = 2.25 * trials * duration_s * RATE_HZ * BYTES_A_SAMPLE
    free = shutil.disk_usage(arguments.folder).free
    if free < needed:
        raise SystemExit(
            f"{needed / 1e9:.0f} GB are needed at {arguments.folder}, {free / 1e9:.0f} GB are free"
        )
    text = TEXT.replace("DURATION", repr(duration_s))
    experiment = Experiment.model_validate(tomllib.loads(text))
    with tempfile.TemporaryDirectory(dir=arguments.folder) as scratch:
        clock = SimulatedClock()
        rig = Rig.build(experiment, clock=clock, seed=1, dry_run=True)
        rig.open()
        folder = RunFolder.create(Path(scratch), "hours", text, {"dry_run": True})
        session = Session(experiment, rig, folder, clock, 1)
        watch = Stopwatch()
        rows = [["before the first trial", "0.0", f"{peak_mb():.0f}", f"{watch.read().wall_s:.0f}"]]
        with folder.lock():
            for done in range(1, trials + 1):
                outcome = session.measure([{"a": 10.0 + 20.0 * done / trials}])[0].outcomes[0]
                if outcome.status != "done":
                    raise SystemExit(f"trial {done} is {outcome.status}: {outcome.reason}")
                if done in {1, 2, max(1, trials // 4), max(1, trials // 2), trials}:
                    hours = f"{done * duration_s / 3600:.2f}"
                    rows.append(
                        [f"{done} trials stored", hours, f"{peak_mb():.0f}", f"{watch.read().wall_s:.0f}"]
                    )
        packed = folder.pack()
        size = packed.stat().st_size / 1e9
        name = f"packed and verified ({size:.1f} GB)"
        rows.append(
            [name, f"{trials * duration_s / 3600:.2f}", f"{peak_mb():.0f}", f"{watch.read().wall_s:.0f}"]
        )
    print(machine("labrun", "h5py", "numpy"))
    print(table(["", "hours recorded", "peak MB", "seconds"], rows))
    print(f"\ngoal {GOAL_MB:.0f} MB: {'held' if peak_mb() < GOAL_MB else 'MISSED'}")


if __name__ == "__main__":
    main()
