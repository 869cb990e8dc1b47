"""What one trial costs beside its physics: labrun, bluesky, QCoDeS, PyMeasure and bare h5py, all data durable on
disk.

    pip install 'labrun[benchmarks]'
    python benchmarks/trial_overhead.py [--trials 2000] [--folder .]

Equal work: a simulated servo is sent to a new pose, a simulated six-axis sensor is read for 1 s at 100 Hz in
simulated time (nobody waits), and the trial is on disk - written, flushed, fsync - before the next one
begins. `trace` stores all 100 x 6 samples with their times, `number` one number a trial, which is how the
others are mostly used. labrun always stores traces.

- labrun: simulated devices through its Session, as `labrun run` makes it: limits checked for every sample and
  pose, safe stop armed, journal, one HDF5 file a trial, objectives, a checkpoint to resume from. Stored as on
  hardware: file, folder, and every line of the journal are synced; a dry run, which need not survive a power
  cut, syncs nothing and has a line of its own. The devices are the shipped stand-ins for a servo and a Robotiq
  FT 300 on a bench with hardly any physics (plain_bench.py); their computing is part of the time. `with
  settling and tare` adds what the others do not do: settling on evidence (2 s hold) and tare. Packing into
  run.h5, written, synced, read back and verified at the end, is divided over the trials and part of all.
- bluesky: RunEngine with ophyd.sim's SynAxis as the servo and a readable detector; a checkpoint and an event
  a trial (mv, trigger_and_read); documents go to a JSONL file by json.dumps. bluesky leaves syncing to the
  subscriber, so the one here does it: fsync after each event and stop document. The trace is seven arrays in
  the event. `one run each` gives every trial a run with metadata of its own, as labrun does (two fsync a
  trial); else all trials are events of one run (of 50; one fsync a trial).
- QCoDeS: Measurement, ManualParameter as the servo; add_result and flush_data_to_database for every trial
  into SQLite. Its own settings are kept: journal_mode=WAL, and synchronous=FULL, which is what SQLite is
  compiled with here and is set once more to be sure. So every commit is one sync of the WAL file, and every
  1000 pages the WAL is copied to the database with two more. The trace is seven array parameters.
  `one run each` as for bluesky; it commits several times a run.
- PyMeasure: the Recorder that its Worker hands every record to, called as the Worker does (Results, CSV); it
  flushes each row itself; fsync once a trial, added here. The trace is 100 rows.
- h5py: rows appended to one open dataset, flush, fsync: the floor, with no experiment around it. An append of
  4 kB to a plain file with fsync tells what the disk is doing meanwhile.

The sides take turns, 50 trials each, so that disk and machine load hit all alike. Everything that is done
once (opening, compiling, the first block) is left out, except labrun's packing. Wall time counts; processor
time is shown beside it.
"""

import argparse
import contextlib
import io
import json
import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from measuring import Cost, Stopwatch, machine, table
from numpy.typing import NDArray

OTHERS = ("bluesky", "ophyd", "qcodes", "pymeasure")
BLOCK = 50
SAMPLES, RATE_HZ, AXES = 100, 100.0, 6
NAMES = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")
LABRUN = """
title = "One second of force"
kind = "sweep"
[rig]
scene = { plugin = "plain_bench:PlainBench" }
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
cycles = 1
SETTLE
[sweep]
axes = { a = [1] }
[objectives]
thrust = { plugin = "mean", channel = "wrench.force_x" }
"""
SETTLE = """
settle = { until = "quiet", channel = "wrench.force_x", hold_s = 2, timeout_s = 60 }
tare = { duration_s = 1, devices = ["wrench"] }
"""


class Sensor:
    """Stands for the others' sensor: noise on six axes around the pose, and the times of the samples."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self.time_s = np.arange(SAMPLES) / RATE_HZ

    def trace(self, pose: float) -> NDArray[np.float64]:
        """Return one second, shape (SAMPLES, AXES)."""
        return pose + self._rng.standard_normal((SAMPLES, AXES))


class Side(ABC):
    """One way to run trials; `run` does one block."""

    name: str

    @abstractmethod
    def run(self, poses: NDArray[np.float64]) -> None: ...

    def finish(self) -> None:  # noqa: B027 - most sides have nothing left to do
        """Do what is left when all trials have run."""


class Labrun(Side):
    def __init__(self, folder: Path, *, settle: bool = False, dry_run: bool = False) -> None:
        import tomllib

        from labrun.experiment import Experiment
        from labrun.runner import Rig, Session, SimulatedClock
        from labrun.store import RunFolder

        self.name = "labrun, trace" + (", with settling and tare" if settle else "")
        self.name += ", dry run" if dry_run else ""
        text = LABRUN.replace("SETTLE", SETTLE if settle else "")
        experiment = Experiment.model_validate(tomllib.loads(text))
        clock = SimulatedClock()
        rig = Rig.build(experiment, clock=clock, seed=1, dry_run=True)
        rig.open()
        self._folder = RunFolder.create(folder, "settled" if settle else "plain", text, {"dry_run": dry_run})
        self._session = Session(experiment, rig, self._folder, clock, 1)
        self._held = contextlib.ExitStack()
        self._held.enter_context(
            self._folder.lock()
        )  # from first trial to packed file, as `labrun run` holds it

    def run(self, poses: NDArray[np.float64]) -> None:
        self._session.measure([{"a": float(pose)} for pose in poses], order="as-listed")

    def finish(self) -> None:
        with self._held:
            self._folder.pack()


class Bluesky(Side):
    def __init__(self, folder: Path, *, trace: bool, each: bool = False) -> None:
        from bluesky import RunEngine
        from event_model import NumpyEncoder
        from ophyd.sim import SynAxis

        self.name = f"bluesky JSONL, {'trace' if trace else 'number'}{', one run each' if each else ''}"
        self._each = each
        self._motor = SynAxis(name="tail")
        self._detector = self._make_detector(trace)
        self._file = (folder / f"bluesky-{trace}-{each}.jsonl").open("w")
        self._engine = RunEngine({}, context_managers=[])

        def write(name: str, document: dict[str, Any]) -> None:
            self._file.write(json.dumps({"name": name, "doc": document}, cls=NumpyEncoder) + "\n")
            self._file.flush()
            if name in ("event", "stop"):
                os.fsync(self._file.fileno())

        self._engine.subscribe(write)

    def _make_detector(self, trace: bool) -> Any:
        from ophyd.sim import SynSignal

        sensor, motor = Sensor(), self._motor

        class Wrench(SynSignal):  # type: ignore[misc]
            """Six axes and their time as one reading; `trigger` takes it."""

            def trigger(self) -> Any:
                self._values = sensor.trace(motor.readback.get())
                return super().trigger()

            def read(self) -> dict[str, Any]:
                now = self.timestamp
                columns = {name: self._values[:, k] for k, name in enumerate(NAMES)} | {
                    "time_s": sensor.time_s
                }
                return {
                    f"wrench_{name}": {"value": value, "timestamp": now} for name, value in columns.items()
                }

            def describe(self) -> dict[str, Any]:
                about = {"source": "SIM:wrench", "dtype": "array", "shape": [SAMPLES]}
                return {f"wrench_{name}": dict(about) for name in (*NAMES, "time_s")}

        def mean_force() -> float:
            return float(sensor.trace(motor.readback.get())[:, 0].mean())

        return Wrench(name="wrench") if trace else SynSignal(func=mean_force, name="thrust")

    def run(self, poses: NDArray[np.float64]) -> None:
        from bluesky import plan_stubs as bps
        from bluesky import preprocessors as bpp

        def plan(some: NDArray[np.float64]) -> Iterator[Any]:
            for pose in some:
                yield from bps.checkpoint()
                yield from bps.mv(self._motor, float(pose))
                yield from bps.trigger_and_read([self._detector, self._motor])

        for some in np.split(poses, len(poses)) if self._each else [poses]:
            self._engine(bpp.run_wrapper(plan(some), md={"pose": float(some[0])}))


class Qcodes(Side):
    def __init__(self, folder: Path, *, trace: bool, each: bool = False) -> None:
        import qcodes

        self.name = f"QCoDeS SQLite, {'trace' if trace else 'number'}{', one run each' if each else ''}"
        self._each = each
        self._trace = trace
        self._sensor = Sensor()
        self._path = folder / f"qcodes-{trace}-{each}.db"
        self._servo = qcodes.parameters.ManualParameter("tail", unit="rad")
        qcodes.dataset.initialise_or_create_database_at(str(self._path))
        self._experiment = qcodes.dataset.load_or_create_experiment("overhead", "rig")
        self._experiment.conn.execute("PRAGMA synchronous=FULL")
        measurement = qcodes.dataset.Measurement(exp=self._experiment)
        measurement.write_period = 3600.0  # what is written, and when, is for `flush_data_to_database` alone
        measurement.register_parameter(self._servo)
        if trace:
            measurement.register_custom_parameter("time_s", unit="s", paramtype="array")
        for name in NAMES if trace else ("thrust",):
            measurement.register_custom_parameter(name, paramtype="array" if trace else "numeric")
        self._measurement = measurement

    def run(self, poses: NDArray[np.float64]) -> None:
        for some in np.split(poses, len(poses)) if self._each else [poses]:
            with (
                contextlib.redirect_stdout(io.StringIO()),
                self._measurement.run(write_in_background=False) as saver,
            ):
                saver.dataset.conn.execute("PRAGMA synchronous=FULL")
                for pose in some:
                    self._servo(float(pose))
                    saver.add_result((self._servo, self._servo()), *self._reading())
                    saver.flush_data_to_database()

    def _reading(self) -> list[tuple[str, Any]]:
        trace = self._sensor.trace(self._servo())
        if not self._trace:
            return [("thrust", float(trace[:, 0].mean()))]
        return [("time_s", self._sensor.time_s), *((name, trace[:, k]) for k, name in enumerate(NAMES))]


class PyMeasure(Side):
    def __init__(self, folder: Path, *, trace: bool) -> None:
        from queue import Queue

        from pymeasure.experiment import FloatParameter, Procedure, Results
        from pymeasure.experiment.listeners import Recorder

        class Pose(Procedure):  # type: ignore[misc]
            """What the file's header tells."""

            amplitude = FloatParameter("Amplitude", units="deg", default=1)
            DATA_COLUMNS = ["pose", "time_s", *NAMES] if trace else ["pose", "thrust"]

        self.name = f"PyMeasure CSV, {'trace' if trace else 'number'}"
        self._trace = trace
        self._sensor = Sensor()
        self._recorder = Recorder(Results(Pose(), str(folder / f"pymeasure-{trace}.csv")), Queue())
        self._stream = self._recorder.handlers[0].stream

    def run(self, poses: NDArray[np.float64]) -> None:
        for pose in poses.tolist():
            trace = self._sensor.trace(pose)
            if self._trace:
                for time_s, row in zip(self._sensor.time_s.tolist(), trace.tolist(), strict=True):
                    record = {"pose": pose, "time_s": time_s, **dict(zip(NAMES, row, strict=True))}
                    self._recorder.handle(record)
            else:
                self._recorder.handle({"pose": pose, "thrust": float(trace[:, 0].mean())})
            os.fsync(self._stream.fileno())


class BareH5py(Side):
    def __init__(self, folder: Path, *, trace: bool) -> None:
        import h5py

        self.name = f"bare h5py append, {'trace' if trace else 'number'}"
        self._trace = trace
        self._sensor = Sensor()
        self._file = h5py.File(folder / f"bare-{trace}.h5", "w")
        width = 2 + AXES if trace else 2
        self._data = self._file.create_dataset(
            "data", (0, width), maxshape=(None, width), chunks=(1024, width), dtype="f8"
        )

    def run(self, poses: NDArray[np.float64]) -> None:
        for pose in poses:
            trace = self._sensor.trace(pose)
            rows = (
                np.column_stack([np.full(SAMPLES, pose), self._sensor.time_s, trace])
                if self._trace
                else np.array([[pose, trace[:, 0].mean()]])
            )
            self._data.resize(len(self._data) + len(rows), axis=0)
            self._data[-len(rows) :] = rows
            self._file.flush()
            os.fsync(self._file.id.get_vfd_handle())


class PlainAppend(Side):
    """What the disk takes for one sync, meanwhile."""

    name = "4 kB appended to a file, fsync"

    def __init__(self, folder: Path) -> None:
        self._file = os.open(folder / "plain.bin", os.O_WRONLY | os.O_CREAT)

    def run(self, poses: NDArray[np.float64]) -> None:
        for _ in poses:
            os.write(self._file, bytes(4096))
            os.fsync(self._file)


def sides(folder: Path) -> list[Side]:
    """Return all sides, and say which are missing."""
    results: list[Side] = [Labrun(folder), Labrun(folder, settle=True), Labrun(folder, dry_run=True)]
    others: list[tuple[Callable[..., Side], dict[str, bool]]] = [
        (Bluesky, {"trace": True, "each": True}), (Bluesky, {"trace": True}), (Bluesky, {"trace": False}),
        (Qcodes, {"trace": True, "each": True}), (Qcodes, {"trace": True}), (Qcodes, {"trace": False}),
        (PyMeasure, {"trace": True}), (PyMeasure, {"trace": False}),
        (BareH5py, {"trace": True}), (BareH5py, {"trace": False}),
        (PlainAppend, {}),
    ]  # fmt: skip
    for make, how in others:
        try:
            results.append(make(folder, **how))
        except ImportError as error:
            print(f"left out: {error}")
    return results


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--folder", type=Path, default=Path(), help="on the disk to measure")
    arguments = parser.parse_args()
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory(dir=arguments.folder) as scratch:
        every = sides(Path(scratch))
        blocks: dict[str, list[Cost]] = {side.name: [] for side in every}
        for _ in range(1 + arguments.trials // BLOCK):
            poses = rng.uniform(5.0, 40.0, BLOCK)
            for side in every:
                watch = Stopwatch()
                side.run(poses)
                blocks[side.name].append(watch.read())
        rows = []
        for side in every:
            watch = Stopwatch()
            side.finish()
            once = watch.read()
            counted = blocks[side.name][1:]
            trials = BLOCK * len(counted)
            wall = 1e3 * (sum(cost.wall_s for cost in counted) + once.wall_s) / trials
            cpu = 1e3 * (sum(cost.cpu_s for cost in counted) + once.cpu_s) / trials
            middle = 1e3 * float(np.median([cost.wall_s for cost in counted])) / BLOCK
            rows.append((side.name, wall, middle + 1e3 * once.wall_s / trials, cpu))
    ours = rows[0][2]
    print(machine("labrun", *(name for name in OTHERS if find_spec(name)), "h5py", "numpy"))
    lines = [
        [n, f"{mean:.2f}", f"{mid:.2f}", f"{cpu:.2f}", f"{mid / ours:.2f}"] for n, mean, mid, cpu in rows
    ]
    print(table([f"ms a trial, {arguments.trials} trials", "mean", "median", "CPU", "times labrun's"], lines))


if __name__ == "__main__":
    main()
