"""What a step of a learning loop costs, and how many steps a second keep their time.

    python benchmarks/control_loop.py                       processor times, then 10 s each in real time
    python benchmarks/control_loop.py --real --seconds 60   real time alone, for as long as the figures are asked for

The source ran its loop at 160 steps a second, with retraining in a process of its own (section 4.3). A dry run is
compared with the time that the bench would take, in processor time, so that a busy machine tells nearly the same.
In real time, against emulated devices, other work on the machine counts.
"""

import argparse
import os
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

import labrun
from labrun.app.run import run
from labrun.control.network import NetworkController
from labrun.control.protocol import LoopContext, VectorStep
from labrun.errors import ExperimentError
from labrun.learned import SlidingAffine, read_learned, to_table

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
SOURCE_HZ = 160.0
FASTER_HZ = (320.0, 640.0)
REPEATS = 5


def median_us(call, count):
    results = []
    for _ in range(REPEATS):
        begin = time.process_time()
        for number in range(count):
            call(number)
        results.append(1e6 * (time.process_time() - begin) / count)
    return statistics.median(results)


CONDITION = 'track.conditions=[{controller="mlp-ik", history_s=3.125, load_g=0, load_from_s=0}]'


def dry_run_us(seconds, rate_hz, *more):
    """Processor time of a step of the whole dry run, without what it takes to start."""
    spent = []
    with tempfile.TemporaryDirectory() as folder:
        for duration_s in (2.0, 2.0, 2.0 + seconds):  # the first one compiles
            changes = [
                f"trial.duration_s={duration_s}",
                f"track.rate_hz={rate_hz:g}",
                "objectives={}",
                CONDITION,
                *more,
            ]
            begin = time.process_time()
            run(EXPERIMENTS / "spm-transfer.toml", dry_run=True, seed=1, overrides=changes, results=folder)
            spent.append(time.process_time() - begin)
    return 1e6 * (spent[2] - spent[1]) / (rate_hz * seconds)


def real_time(seconds, rate_hz, frames_hz, *more):
    """Run the loop against emulated devices; print how it kept its time."""
    changes = [
        f"trial.duration_s={seconds}", f"track.rate_hz={rate_hz:g}", "objectives={}", CONDITION,
        "track.max_missed_share=1", "rig.devices.servos.baud=4000000",
        f"rig.devices.cameras.rate_hz={frames_hz}", *more,
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        try:
            run(EXPERIMENTS / "spm-transfer.toml", emulate=True, seed=1, overrides=changes, results=folder)
        except (
            ExperimentError
        ) as error:  # a loop that ended early: what is left of its steps count as skipped
            print(f"ended early: {error}")
        loop = labrun.open("spm-transfer", folder).signals("loop", 0).load()
    begun_s, missed, reaction_s = (loop[name].to_numpy() for name in ("time_s", "missed", "reaction_s"))
    due = round(rate_hz * seconds)
    skipped = due - len(begun_s)
    fresh = np.isfinite(reaction_s)
    newest = np.maximum.accumulate(np.where(fresh, np.arange(len(begun_s)), -1))
    known = newest >= 0
    age_s = reaction_s[newest[known]] + begun_s[known] - begun_s[newest[known]]
    late = int(np.count_nonzero(missed)) + skipped
    print(f"{rate_hz:g} steps a second, {frames_hz} frames a second, {seconds:g} s:")
    print(f"  steps late or skipped       {late} of {due} ({100 * late / due:.3f} %)")
    print(f"  trainings                   {float(loop['pose_trainings'].max()):.0f}")
    apart = [rate_hz * np.quantile(np.diff(begun_s), share) for share in (0.01, 0.5, 0.99, 1.0)]
    print("  periods from step to step   {:.2f}, {:.2f}, {:.2f}, {:.2f} (1, 50, 99, 100 %)".format(*apart))
    for name, times_s in (
        ("sample to its first command", reaction_s[fresh]),
        ("newest sample to a command", age_s),
    ):
        median, high = (1e3 * np.quantile(times_s, share) for share in (0.5, 0.99))
        within = 100 * np.mean(times_s <= 1e-3)
        print(f"  {name:27} {median:.2f} ms in the median, {high:.2f} ms at 99 %; {within:.1f} % within 1 ms")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--real", action="store_true", help="real time alone")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each run in real time")
    asked = parser.parse_args()
    if not asked.real:
        processor_times()
    for rate_hz in (SOURCE_HZ, *FASTER_HZ):
        real_time(asked.seconds, rate_hz, 160)
    print(f"load of the machine meanwhile: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


def processor_times():
    """Print what steps cost."""
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
    print(f"network, one step                       {network_us:8.1f} us")
    print(f"training, one sample in and one out     {training_us:8.1f} us")
    faster = 1e6 / SOURCE_HZ / python_us
    print(
        f"dry run of spm-transfer, a step         {python_us:8.1f} us: {faster:.1f} times faster than the bench"
    )


if __name__ == "__main__":
    main()
