"""Small runs for the tests of the store."""

import json
from pathlib import Path

import numpy as np

from labrun.devices import Channel, Samples, Trajectory
from labrun.signals import Signals
from labrun.store.folder import RunFolder
from labrun.store.trial import SettleSummary, TrialOutcome, settle_curve

SPEC = 'title = "Thrust"\n[units]\nb = "deg"\n'
WRENCH = (Channel("force_x", "N"), Channel("torque_z", "N m"))
RATE_HZ = 100.0


def new_run(results: Path, spec: str = SPEC) -> RunFolder:
    return RunFolder.create(results, "fin", spec, {"seed": 7})


def outcome(index: int, **changes: object) -> TrialOutcome:
    fields: dict[str, object] = {
        "condition": {"b": 0.1 * index, "foil": "stiff"},
        "repeat": index % 3,
        "started_s": 100.0 * index,
        "duration_s": 2.0,
        "objectives": {"thrust": 1 / (index + 3)},
        "tare": {"wrench.force_x": 0.25},
        "settle": SettleSummary("quiet", 3.5, spread=0.01, drift=0.002, bound=0.02, channel="wrench.force_x"),
        "checkpoint": json.dumps({"clock_s": 100.0 * index, "scene": {"eddies": [0.1, 1e-300, 3.0]}}),
        "period_s": 0.5,
        "discard_cycles": 1,
    }
    return TrialOutcome(index, **(fields | changes))


def samples(index: int, count: int = 200) -> Samples:
    rng = np.random.default_rng(index)
    device_time_s = 5.0 + np.arange(count) / RATE_HZ
    host_time_s = device_time_s - 5.0 + 100.0 * index + rng.exponential(2e-3, count)
    return Samples(device_time_s, host_time_s, rng.normal(size=(count, 2)), lost=index, saturated=1)


def motion(count: int = 50) -> Trajectory:
    time_s = np.linspace(0, 2, count)
    return Trajectory(("tail",), time_s, np.sin(time_s)[:, None], period_s=0.5)


def curve() -> Signals:
    time_s = np.linspace(0, 3.5, 20)
    return settle_curve(time_s, np.exp(-time_s), 0.1 * np.exp(-time_s), "N")


def store(folder: RunFolder, index: int, count: int = 200, **changes: object) -> TrialOutcome:
    writer = folder.writer(index)
    writer.append("wrench", WRENCH, RATE_HZ, samples(index, count))
    stored = outcome(index, **changes)
    writer.finish(stored, curve(), motion())
    return stored


def store_many(folder: RunFolder, count: int) -> dict[int, TrialOutcome]:
    return {index: store(folder, index) for index in range(count)}


def assert_as_measured(stream: Signals, index: int, count: int = 200) -> None:
    measured = samples(index, count)
    np.testing.assert_array_equal(stream.values, measured.values)
    np.testing.assert_array_equal(stream.device_time_s, measured.device_time_s)
    np.testing.assert_array_equal(stream.host_time_s, measured.host_time_s)
    assert (stream.lost, stream.saturated, stream.rate_hz) == (index, 1, RATE_HZ)
    assert tuple(map(Channel, stream.columns, stream.units)) == WRENCH
    assert np.all(np.diff(stream.time_s) > 0)
