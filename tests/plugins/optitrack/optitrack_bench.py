"""A driver of the motion capture in front of an emulated Motive that sees the hinge bench."""

import numpy as np

from labrun.devices import Samples

KEYS = {
    "host": "192.168.1.10",
    "rate_hz": 240,
    "bodies": ["arm"],
    "angles": {"angle": {"body": "arm", "axis": [0, 1, 0]}},
    "markers": {"arm": 2},
}
BENCH = {"name": "cameras", "scene": "hinge-bench"}
PERIOD_S = 1.0 / 240


def collect(bench, until, within_s=5.0) -> Samples:
    """Read until a condition on the samples so far holds; AssertionError if it does not in time."""
    blocks = []

    def enough():
        blocks.append(bench.driver.read())
        return until(Samples.join(blocks, len(bench.driver.channels)))

    bench.wait_until(enough, within_s)
    return Samples.join(blocks, len(bench.driver.channels))


def at_least(count: int):
    """Return the condition that so many samples came."""
    return lambda samples: len(samples) >= count


def is_one_row_of_frames(samples: Samples) -> bool:
    """Tell whether frames are in order, none twice, gaps as counted, times apart as exposed."""
    steps = np.diff(samples.device_time_s) / PERIOD_S
    numbers = np.round(steps)
    return bool(
        np.all(numbers >= 1)
        and np.allclose(steps, numbers, atol=0.01)
        and np.sum(numbers - 1) <= samples.lost
        and np.all(np.diff(samples.host_time_s) >= 0)
    )
