"""A one-axis load cell, simulated."""

from typing import ClassVar

import numpy as np

from labrun.devices import Channel, DeviceContext, DeviceSettings, Health, Identity, Samples


class SimulatedLoadCell:
    """Forward force at 80 samples/s (an HX711 at its fast setting) with 5 mN of noise."""

    class Settings(DeviceSettings):
        """Nothing but the limits all devices have."""

    channels: ClassVar[tuple[Channel, ...]] = (Channel("force_x", "N"),)
    rate_hz = 80.0

    def __init__(self, name: str, settings: Settings, context: DeviceContext) -> None:
        self.name = name
        self._clock, self._scene, self._rng = context.clock, context.scene, context.rng
        self._next = 0

    def open(self) -> None:
        pass

    def identify(self) -> Identity:
        return Identity("HX711 load cell", serial="paddle-1")

    def health(self) -> Health:
        return Health()

    def reseed(self, seed: np.random.SeedSequence) -> None:
        self._rng = np.random.default_rng(seed)

    def safe_stop(self) -> None:
        pass

    def close(self) -> None:
        pass

    def start(self) -> None:
        self._next = int(np.ceil(self._clock.now() * self.rate_hz))

    def read(self) -> Samples:
        last = int(np.floor(self._clock.now() * self.rate_hz))
        if last < self._next:
            return Samples.empty(1)
        time_s = np.arange(self._next, last + 1) / self.rate_hz
        self._next = last + 1
        force = self._scene.observe(["force_x"], time_s) + self._rng.normal(0, 5e-3, (len(time_s), 1))
        return Samples(time_s, time_s, force)

    def stop(self) -> None:
        pass
