"""What the tests of the Net F/T driver share."""

from typing import Any

import numpy as np
from emulated import EmulatedDevice
from labrun_plugins.ati_netft.driver import AtiNetFt
from labrun_plugins.ati_netft.settings import AtiNetFtSettings

from labrun.devices import DeviceContext, Samples
from labrun.runner import RealClock


def another_driver(bench: EmulatedDevice, **keys: Any) -> EmulatedDevice:
    """Return another driver, with other settings, in front of the same box."""
    settings = AtiNetFtSettings.model_validate({**bench.bench.table(bench.name).settings, **keys})
    clock = RealClock()
    driver = AtiNetFt(bench.name, settings, DeviceContext(clock, np.random.default_rng(1)))
    return EmulatedDevice(bench.name, driver, clock, bench.bench)


def heard(bench: EmulatedDevice, duration_s: float) -> Samples:
    """Return what a running stream gives in some time."""
    blocks, until_s = [], bench.clock.now() + duration_s
    while bench.clock.now() < until_s:
        bench.clock.sleep(0.02)
        blocks.append(bench.driver.read())
    return Samples.join(blocks, 6)


def failure(bench: EmulatedDevice, within_s: float = 5.0) -> Exception | None:
    """Read until something is raised, and return it; None if nothing is in time."""
    until_s = bench.clock.now() + within_s
    while bench.clock.now() < until_s:
        bench.clock.sleep(0.01)
        try:
            bench.driver.read()
        except Exception as error:
            return error
    return None


def is_gapless(samples: Samples, step_s: float) -> bool:
    """Tell whether the device times rise by one step each."""
    return bool(np.allclose(np.diff(samples.device_time_s), step_s, rtol=0, atol=1e-6))
