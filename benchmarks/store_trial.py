"""What durable storage of one trial costs, beside a bare HDF5 append in the same run on the same disk.

    python benchmarks/store_trial.py [--trials 200] [--folder .]

Prints ms per trial (mean and 95th percentile) for: labrun storing a 10 s trial of 100 Hz x 6 channels with command
and settle curve (file, directory and journal line synced); h5py alone appending the same samples to one open
dataset, flush and fsync; packing; and what xarray needs to open the packed run as a tree.
"""

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from measuring import machine

from labrun.devices import Channel, Samples, Trajectory
from labrun.store import RunFolder, SettleSummary, TrialOutcome, settle_curve

CHANNELS = tuple(Channel(f"force_{axis}", "N") for axis in "xyz") + tuple(
    Channel(f"torque_{axis}", "N m") for axis in "xyz"
)
COUNT = 1000
RATE_HZ = 100.0


def store_with_labrun(folder: RunFolder, index: int, rng: np.random.Generator) -> float:
    """Return the seconds one trial takes from its samples to the synced journal."""
    time_s = np.arange(COUNT) / RATE_HZ
    samples = Samples(time_s, time_s + 1 + rng.exponential(1e-3, COUNT), rng.normal(size=(COUNT, 6)))
    command = Trajectory(("tail",), time_s, np.sin(time_s)[:, None])
    curve = settle_curve(time_s[:60], rng.normal(size=60), rng.normal(size=60), "N")
    outcome = TrialOutcome(
        index,
        {"b": 0.0, "a": 30.0, "f": 1.4},
        0,
        started_s=1.0,
        duration_s=10.0,
        objectives={"thrust": 0.1, "side": 0.0},
        tare={f"wrench.{channel.name}": 0.1 for channel in CHANNELS},
        settle=SettleSummary("quiet", 6.0, 0.01, 0.002),
        checkpoint=json.dumps({"clock_s": 11.0, "scene": {"state": [0.1] * 20}}),
    )
    start = time.perf_counter()
    writer = folder.writer(index)
    writer.append("wrench", CHANNELS, RATE_HZ, samples)
    writer.finish(outcome, curve, command)
    return time.perf_counter() - start


def append_bare(dataset: h5py.Dataset, rng: np.random.Generator) -> float:
    """Return the seconds h5py takes to append the same samples, flush and fsync."""
    values = rng.normal(size=(COUNT, 8))
    start = time.perf_counter()
    dataset.resize(len(dataset) + COUNT, axis=0)
    dataset[-COUNT:] = values
    dataset.file.flush()
    os.fsync(dataset.file.id.get_vfd_handle())
    return time.perf_counter() - start


def report(what: str, seconds: list[float]) -> None:
    print(f"{what:34s} {1e3 * np.mean(seconds):7.2f} ms mean {1e3 * np.percentile(seconds, 95):7.2f} ms p95")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=Path())
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    print(machine("labrun", "h5py", "numpy", "xarray", "h5netcdf"))
    with tempfile.TemporaryDirectory(dir=arguments.folder) as scratch:
        folder = RunFolder.create(Path(scratch), "benchmark", 'title = "benchmark"\n', {})
        labrun, bare = [], []
        with folder.lock(), h5py.File(Path(scratch) / "bare.h5", "w") as file:
            dataset = file.create_dataset("x", (0, 8), maxshape=(None, 8), chunks=(COUNT, 8), dtype="f8")
            for index in range(arguments.trials):  # in turns, so that both see the same disk
                labrun.append(store_with_labrun(folder, index, rng))
                bare.append(append_bare(dataset, rng))
            report("labrun, whole trial, durable", labrun)
            report("h5py, append + flush + fsync", bare)
            start = time.perf_counter()
            packed = folder.pack()
            print(
                f"{'pack and verify':34s} {1e3 * (time.perf_counter() - start) / arguments.trials:7.2f} ms a trial"
            )
        import xarray

        start = time.perf_counter()
        xarray.open_datatree(packed, engine="h5netcdf").close()
        print(
            f"{'xarray.open_datatree':34s} {time.perf_counter() - start:7.2f} s for {arguments.trials} trials"
        )


if __name__ == "__main__":
    main()
