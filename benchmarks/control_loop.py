"""What a step of a learning loop costs: processor time of a dry run's step, of its network alone, and of a training.

    python benchmarks/control_loop.py

The source ran its loop at 160 steps a second, with retraining in a process of its own (section 4.3). A dry run is
compared with the time that the bench would take. Processor times, so that a busy machine tells nearly the same; how
well steps keep their time is told by every run itself: labrun show.
"""

import os
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from labrun.app.run import run
from labrun.control.network import NetworkController
from labrun.control.protocol import LoopContext, VectorStep
from labrun.learned import SlidingAffine, read_learned, to_table

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
SOURCE_HZ = 160.0
COMPILED_HZ = 1000.0
REPEATS = 5


def median_us(call, count):
    found = []
    for _ in range(REPEATS):
        begin = time.process_time()
        for number in range(count):
            call(number)
        found.append(1e6 * (time.process_time() - begin) / count)
    return statistics.median(found)


def dry_run_us(seconds, rate_hz, *more):
    """Processor time of a step of the whole dry run, without what it takes to start."""
    spent = []
    with tempfile.TemporaryDirectory() as folder:
        for duration_s in (2.0, 2.0, 2.0 + seconds):  # the first one compiles
            changes = [
                f"trial.duration_s={duration_s}",
                f"track.rate_hz={rate_hz:g}",
                "objectives={}",
                'track.conditions=[{controller="mlp-ik", history_s=3.125, load_g=0, load_from_s=0}]',
                *more,
            ]
            begin = time.process_time()
            run(EXPERIMENTS / "spm-transfer.toml", dry_run=True, seed=1, overrides=changes, results=folder)
            spent.append(time.process_time() - begin)
    return 1e6 * (spent[2] - spent[1]) / (rate_hz * seconds)


def main():
    model = read_learned(EXPERIMENTS / "models" / "mlp-ik.toml")
    drives = dict(model.outputs)
    context = LoopContext(
        1e-3, -58.0, 58.0, 0.0, components=tuple(model.inputs), drives=drives, rig="spm-load"
    )
    controller = NetworkController({"model": to_table(model)}, context)
    q = (0.99, 0.1, 0.05, 0.01)
    step = VectorStep(0.0, 1e-3, q, q, (0.0, 0.0), lambda _: q, 0.0, {}, {})
    network_us = median_us(lambda _: controller.update(step), 5000)
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(5000, 4)), rng.normal(size=(5000, 2))
    solver = SlidingAffine(model.network.collapsed(), 1000, 1e-4)

    def training(number):
        solver.add(x[number : number + 1], y[number : number + 1])
        solver.solved()

    training_us = median_us(training, 2000)
    python_us = dry_run_us(30.0, SOURCE_HZ)
    compiled_us = dry_run_us(
        60.0,
        COMPILED_HZ,
        "track.compiled=true",
        "rig.devices.servos.command_hz=1000",
        *(f"track.loops.pose.controllers.{name}.learn.every=1" for name in ("mlp-ik", "mlp-error")),
    )
    print(f"network, one step                       {network_us:8.1f} us")
    print(f"training, one sample in and one out     {training_us:8.1f} us")
    for name, hz, us in (("in Python", SOURCE_HZ, python_us), ("compiled", COMPILED_HZ, compiled_us)):
        print(f"dry run of spm-transfer, a step {name:9}{us:7.1f} us: {1e6 / hz / us:.1f} times faster than the bench"
              f" at {hz:g} Hz")  # fmt: skip
    print(f"load of the machine meanwhile: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    main()
