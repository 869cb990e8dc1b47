"""A driver and its emulator, in two processes, with a real clock and a real pty or socket between them."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from forked_labrun import forked_emulators

from labrun.devices import DeviceContext
from labrun.runner import EmulatedBench, RealClock, resolve_device
from labrun.toml import PluginTable

POLL_S = 0.005


@dataclass
class EmulatedDevice:
    """One driver, not yet open, and its emulator, which is."""

    name: str
    driver: Any
    clock: RealClock
    bench: EmulatedBench

    def inject(self, fault: str, value: Any = True) -> None:
        """Bring a fault about, and wait until the emulator knows of it."""
        before = sum(line["event"] == "fault" for line in self.log())
        self.bench.inject(self.name, fault, value)
        self._until(lambda: sum(line["event"] == "fault" for line in self.log()) > before, 5.0)

    def clear(self, fault: str) -> None:
        """End a fault."""
        self.inject(fault, None)

    def log(self) -> list[dict[str, Any]]:
        """Return what the emulator has witnessed."""
        return self.bench.log(self.name)

    def events(self, event: str) -> list[dict[str, Any]]:
        """Return the emulator's lines of one kind."""
        return [line for line in self.log() if line["event"] == event]

    def wait_for(self, event: str, within_s: float = 5.0, after_s: float = 0.0) -> dict[str, Any]:
        """Return the first line of this kind after a time; AssertionError if there is none in time."""
        result = self._until(lambda: [x for x in self.events(event) if x["time_s"] >= after_s], within_s)
        assert result, f"the emulator of {self.name} saw no {event!r} within {within_s} s: {self.log()[-20:]}"
        line: dict[str, Any] = result[0]
        return line

    def wait_until(self, true: Any, within_s: float = 5.0) -> None:
        """Wait until a condition holds; AssertionError if it does not in time."""
        assert self._until(true, within_s), f"did not come true within {within_s} s"

    def restore(self) -> None:
        """End all faults, and close the driver."""
        for fault in {line["name"] for line in self.events("fault")}:
            self.bench.clear(self.name, fault)
        self.clear("last")
        self.driver.close()

    def collect(self, driver: Any, duration_s: float) -> dict[str, Any]:
        """Return all that a streaming sensor hands over for a while."""
        blocks = []
        until_s = self.clock.now() + duration_s
        while self.clock.now() < until_s:
            self.clock.sleep(0.02)
            blocks.append(driver.read())
        return {
            "host_s": np.concatenate([block.host_time_s for block in blocks]),
            "device_s": np.concatenate([block.device_time_s for block in blocks]),
            "values": np.concatenate([block.values for block in blocks]),
            "lost": sum(block.lost for block in blocks),
            "saturated": sum(block.saturated for block in blocks),
        }

    def read_until_it_fails(self, driver: Any, within_s: float = 10.0) -> None:
        """Read until the driver raises; AssertionError if it does not in time."""
        until_s = self.clock.now() + within_s
        while self.clock.now() < until_s:
            driver.read()
            self.clock.sleep(0.01)
        raise AssertionError("nothing failed")

    def answers_again(self, driver: Any) -> None:
        """Open the driver anew, and see that it streams."""
        driver.close()
        driver.open()
        driver.start()
        self.wait_until(lambda: len(driver.read()))
        driver.close()

    def _until(self, look: Any, within_s: float) -> Any:
        deadline_s = self.clock.now() + within_s
        while not (result := look()) and self.clock.now() < deadline_s:
            self.clock.sleep(POLL_S)
        return result


@contextmanager
def emulated(
    plugin: str,
    settings: Mapping[str, Any] | None = None,
    *,
    name: str = "device",
    scene: str | None = None,
    scene_settings: Mapping[str, Any] | None = None,
    faults: Mapping[str, Any] | None = None,
    seed: int = 1,
) -> Iterator[EmulatedDevice]:
    """Start the emulator of a plugin, and make its driver; both are closed at the end."""
    table = PluginTable.model_validate({"plugin": plugin, **(settings or {})})
    bench_of = {"plugin": scene, **(scene_settings or {})}
    scene_table = None if scene is None else PluginTable.model_validate(bench_of)
    with (
        forked_emulators(),
        EmulatedBench({name: table}, scene_table, seed=seed, faults={name: faults or {}}) as bench,
    ):
        item = resolve_device(name, bench.table(name), dry_run=False)
        clock = RealClock()
        driver = item.make(name, item.settings, DeviceContext(clock, np.random.default_rng(seed)))
        try:
            yield EmulatedDevice(name, driver, clock, bench)
        finally:
            driver.safe_stop()
            driver.close()
