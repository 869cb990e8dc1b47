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
REPEATS = 5


def median_us(call, count):
    found = []
    for _ in range(REPEATS):
        begin = time.process_time()
        for number in range(count):
            call(number)
        found.append(1e6 * (time.process_time() - begin) / count)
    return statistics.median(found)


def dry_run_us(seconds):
    """Processor time of a step of the whole dry run, without what it takes to start."""
    spent = []
    with tempfile.TemporaryDirectory() as folder:
        for duration_s in (2.0, seconds):
            changes = [
                f"trial.duration_s={duration_s}",
                "objectives={}",
                'track.conditions=[{controller="mlp-ik", history_s=3.125, load_g=0, load_from_s=0}]',
            ]
            begin = time.process_time()
            run(EXPERIMENTS / "spm-transfer.toml", dry_run=True, seed=1, overrides=changes, results=folder)
            spent.append(time.process_time() - begin)
    return 1e6 * (spent[1] - spent[0]) / (SOURCE_HZ * (seconds - 2.0))


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
    whole_us = dry_run_us(32.0)
    print(f"network, one step                       {network_us:8.1f} us")
    print(f"training, one sample in and one out     {training_us:8.1f} us")
    print(f"dry run of spm-transfer, one step       {whole_us:8.1f} us")
    times = [1e6 / hz / whole_us for hz in (SOURCE_HZ, 1000.0)]
    print(
        f"  the bench takes {times[0]:.1f} times as long at {SOURCE_HZ:g} Hz, {times[1]:.2f} times at 1000 Hz"
    )
    print(f"load of the machine meanwhile: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    main()
