"""The process of a simulated bench: what it does before it says that it is ready."""

import numpy as np

from labrun import registry
from labrun.devices.processes.scene import _compile


def test_a_bench_has_been_looked_at_before_it_is_ready_and_remembers_nothing_of_it():
    looked_at, untouched = (
        registry.load("labrun.scenes", "spm-load")({}, np.random.default_rng(5)) for _ in range(2)
    )
    _compile(looked_at)
    names = tuple(untouched.signals)
    time_s = np.array([3.0, 3.5])
    assert np.array_equal(looked_at.observe(names, time_s), untouched.observe(names, time_s))
