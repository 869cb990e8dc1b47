"""What the tests of the arm share: emulators that live as long as a file's tests, and a new driver for each test."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from emulated import EmulatedDevice, emulated

from labrun.devices import DeviceContext, DeviceError

TABLE = {
    "host": "192.168.1.2",
    "limits": {"travel_m": [0.0, 0.7], "speed_m_s": 0.1},
    "origin_m": [-0.35, -0.4, 0.3],
    "watchdog_ms": 1000,
}
"""A patient watchdog: tests share their processors, and only the test of the watchdog is about it."""


def another(bench: EmulatedDevice, **keys: Any) -> Any:
    """Return a driver of the same arm that is not open, with other keys than the table's."""
    settings = type(bench.driver).Settings.model_validate({**TABLE, **bench.bench.settings[bench.name]})
    context = DeviceContext(bench.clock, np.random.default_rng(1))
    return type(bench.driver)("arm", settings.model_copy(update=keys), context)


@contextmanager
def as_new(bench: EmulatedDevice) -> Iterator[EmulatedDevice]:
    """Give a bench a new driver; close it at the end, and end all faults."""
    bench.driver = another(bench)
    try:
        yield bench
    finally:
        present = {line["name"]: line["value"] for line in bench.events("fault")}
        for name, value in present.items():
            if value not in (None, False):
                bench.clear(name)
        bench.driver.safe_stop()
        bench.driver.close()


def served(scene: str | None = None, **faults: Any) -> Any:
    """Return an emulator of the table's arm."""
    return emulated("ur5", TABLE, name="arm", scene=scene, faults=faults)


def moving(bench: EmulatedDevice) -> Any:
    """Return the arm, streaming, on its way to the farther end of the line."""
    arm = bench.driver
    arm.open()
    arm.start()
    begin(bench)
    return arm


def begin(bench: EmulatedDevice) -> None:
    """Start a long move, and wait until the arm executes it."""
    arm = bench.driver
    begun_s = bench.clock.now()
    arm.travel(0.05 if arm.position_m() > 0.3 else 0.6, 0.1)
    bench.wait_for("command", after_s=begun_s)


def arrived(bench: EmulatedDevice) -> None:
    """Wait until the move under way is over."""
    bench.wait_until(lambda: bench.driver._link.tracking.move.phase == "arrived", 10.0)


def since(bench: EmulatedDevice, event: str, time_s: float) -> list[dict[str, Any]]:
    """Return the emulator's lines of one kind from a time on."""
    return [line for line in bench.events(event) if line["time_s"] >= time_s]


def error_of(bench: EmulatedDevice, look: Any, within_s: float = 5.0) -> str:
    """Return the words of the first error that a look at the arm raises."""
    results: list[str] = []

    def raises() -> bool:
        try:
            look()
        except DeviceError as error:
            results.append(str(error))
        return bool(results)

    bench.wait_until(raises, within_s)
    assert results[0].startswith("device arm: ")
    assert "\n  " in results[0], "an error says what to do next"
    return results[0]


def works_again(bench: EmulatedDevice) -> bool:
    """Tell whether the arm moves and streams after it was closed and opened."""
    arm = bench.driver
    arm.close()
    arm.open()
    arm.start()
    begun_s = bench.clock.now()
    here_m = arm.position_m()
    arm.travel(here_m + (0.01 if here_m < 0.3 else -0.01), 0.1)
    bench.wait_for("command", after_s=begun_s)
    arrived(bench)
    return len(arm.read()) > 0
