"""What all simulated devices share: their settings, their life, their scene, and their faults."""

import math
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, NonNegativeFloat

from labrun.devices import DeviceContext, DeviceError, DeviceSettings, Health, Identity, Scene, opened
from labrun.toml import Keys


class Faults(Keys):
    """Bad days on request. Times run from `open`.

    Attributes
    ----------
    stop_answering_after_s
        From then on the device is silent: a sensor sends nothing, an actuator refuses every command.
    nonsense_after_s
        From then on a sensor's values are far outside its range, or not numbers.
    saturate
        A sensor's values all stand at the end of its range.
    drop_share
        Share of a sensor's samples that never arrive, besides those that get lost anyway.
    """

    stop_answering_after_s: NonNegativeFloat | None = None
    nonsense_after_s: NonNegativeFloat | None = None
    saturate: bool = False
    drop_share: float = Field(default=0.0, ge=0.0, le=1.0)


class SimulatedSettings(DeviceSettings):
    """Settings of a simulated device.

    Attributes
    ----------
    faults
        Bad days on request.
    stop_log
        File that gets one line for every stop, so that a test can witness who stopped the motion, and when.
    """

    faults: Faults = Faults()
    stop_log: Path | None = None

    def log_stop(self, device: str, kind: str) -> None:
        """Append process, wall time, device and kind of stop to `stop_log`; never raises."""
        if self.stop_log is None:
            return
        line = f"{os.getpid()} {datetime.now(UTC).isoformat()} {device} {kind}\n"
        try:
            with self.stop_log.open("a", encoding="utf-8") as file:
                file.write(line)
        except OSError:
            pass  # a stop must never fail because its witness cannot write


class SimulatedDevice:
    """A device that exists only in a dry run."""

    model: ClassVar[str] = "simulated device"

    def __init__(self, name: str, settings: SimulatedSettings, context: DeviceContext) -> None:
        self.name = name
        self._limits = settings.limits
        self._faults = settings.faults
        self._log_stop = settings.log_stop
        self._clock = context.clock
        self._rng = context.rng
        self._scene = context.scene
        self._opened_s: float | None = None

    @property
    def closed(self) -> bool:
        """Tell whether the device is not connected."""
        return self._opened_s is None

    @property
    def scene(self) -> Scene:
        """The simulated bench. Raises DeviceError: the experiment names none."""
        if self._scene is None:
            raise DeviceError(
                self.name,
                "a simulated device needs a simulated bench",
                hint='name one in the experiment file: [rig] scene = "caudal-tank"; see labrun plugins',
            )
        return self._scene

    def open(self) -> None:
        """Connect to the scene."""
        self.scene  # noqa: B018 -- raises without a scene
        self._opened_s = self._clock.now()

    def identify(self) -> Identity:
        """Say what this stands in for."""
        self._require_open()
        return Identity(model=self.model, serial="simulated", firmware="simulated")

    def health(self) -> Health:
        """Report no complaint unless the device no longer answers."""
        if self.closed:
            return Health(ok=False, notes=("not connected",))
        if self._silent():
            return Health(ok=False, notes=("no answer",))
        return Health()

    def safe_stop(self) -> None:
        """Stop all motion: a device without motion only notes that it was asked to."""
        self._log_stop(self.name, "safe_stop")

    def close(self) -> None:
        """Disconnect; harmless when not connected."""
        self._opened_s = None

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Note the stop where `stop_log` asks for it: what is simulated ends with its process."""
        settings.log_stop(name, "emergency_stop")

    def _require_open(self) -> float:
        return opened(self.name, self._opened_s)

    def _since_open_s(self) -> float:
        return self._clock.now() - self._require_open()

    def _silent_from_s(self) -> float:
        after = self._faults.stop_answering_after_s
        return math.inf if after is None else self._require_open() + after

    def _silent(self) -> bool:
        return self._clock.now() >= self._silent_from_s()

    def _require_answer(self) -> None:
        self._require_open()
        if self._silent():
            raise DeviceError(
                self.name, "does not answer", hint="check its power and its cable, then labrun resume"
            )

    def _require_signals(self, signals: tuple[str, ...]) -> None:
        missing = [signal for signal in signals if signal not in self.scene.signals]
        if missing:
            raise DeviceError(
                self.name,
                f"this bench has no {', '.join(missing)}",
                hint=f"it shows {', '.join(sorted(self.scene.signals))}",
            )


class SimulatedCarriage(SimulatedDevice):
    """What moves the carriage of the bench."""

    needs: ClassVar[tuple[str, ...]] = ("position",)
    """Signals of the bench without which there is nothing to move."""

    def open(self) -> None:
        """Connect. Raises DeviceError: this bench has no carriage."""
        self._require_signals(self.needs)
        super().open()

    def position_m(self) -> float:
        """Where the carriage is, m."""
        self._require_answer()
        return self._here_m(self.scene)

    def safe_stop(self) -> None:
        """Stop where it is."""
        super().safe_stop()
        if not self.closed and self._scene is not None:
            here_m = self._here_m(self._scene)
            self._scene.tow(here_m, here_m, 0.0, self._clock.now())

    def _here_m(self, scene: Scene) -> float:
        return float(scene.observe(("position",), np.array([self._clock.now()]))[0, 0])

    def _check_travel(self, to_m: float, speed_m_s: float) -> None:
        """Refuse a move without a speed, or beyond the limits of the experiment file."""
        self._require_answer()
        self._limits.require_move(self.name, to_m, speed_m_s)
