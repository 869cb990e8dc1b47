"""A channel that leaves its bounds ends a trial; whether the trial counts depends on when."""

from types import SimpleNamespace

import numpy as np
import pytest

from labrun.devices import Channel, Samples
from labrun.runner import within_bounds
from labrun.runner.recording import TrialRecording

START_S, DURATION_S = 10.0, 2.5


def recorded(*heard):
    """Record a swimmer that is heard of at these times (s from the start) and places (m); its tank ends at 1 m."""
    kept, stops = [], []
    cameras = SimpleNamespace(channels=(Channel("x", "m"),))
    rig = SimpleNamespace(sensors={"cameras": cameras}, safe_stop=lambda: stops.append(True))
    bench = SimpleNamespace(rig=rig)
    collector = SimpleNamespace(bench=bench, writer=SimpleNamespace(), take=kept.append)
    experiment = SimpleNamespace(
        kind="run", cmaes=None, trial=SimpleNamespace(within={"cameras.x": (0.0, 1.0)})
    )

    def swims(recording):
        recording.begin(START_S)
        for at_s, x_m in heard:
            times = np.array([START_S + at_s])
            recording.collector.take({"cameras": Samples(times, times, np.array([[x_m]]))})

    recording = TrialRecording(
        bench,
        SimpleNamespace(duration_s=DURATION_S),
        SimpleNamespace(role="measure"),
        {},
        collector,
        lambda _: None,
    )
    within_bounds(swims, experiment)(recording)
    return recording.fault, len(kept), len(stops)


@pytest.mark.parametrize(
    ("heard", "fault", "kept", "stops"),
    [
        (((1.0, 0.4), (2.4, 0.9)), "", 2, 0),
        (((1.0, 1.2), (2.4, 1.5)), "cameras.x = 1.2 m is outside 0 ... 1: stopped", 1, 1),
        (((2.4, 0.9), (2.55, 1.1), (2.58, 1.2)), "", 2, 1),
    ],
    ids=["stays inside", "leaves during the motion", "leaves when the motion is over"],
)
def test_who_leaves_is_stopped_and_counts_only_if_the_motion_was_over(heard, fault, kept, stops):
    assert recorded(*heard) == (fault, kept, stops)
