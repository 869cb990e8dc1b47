"""Stand-in for a UR5 arm (CB3) that carries the specimen along a straight line."""

from typing import Any, ClassVar

import numpy as np

from labrun.devices import Channel, DeviceContext, DeviceError, DeviceSettings, FloatArray, Port
from labrun.errors import LimitExceededError
from labrun_plugins.simulated.sensor import SimulatedSensor
from labrun_plugins.simulated.settings import SimulatedSettings
from labrun_plugins.simulated.stream import Timing

_POSITION_SD_M = 2e-5
_REACH_M = (0.0, 0.8)


class Ur5Settings(SimulatedSettings):
    """Keys of the arm: `host` is its controller; `limits` bound travel and speed of the carriage."""

    host: Port


class SimulatedUr5(SimulatedSensor):
    """Carriage, and sensor of its own position at 125 Hz with the controller's time stamps.

    125 Hz is the RTDE rate of a CB3 controller, which now and then skips a package (chosen: one in 5000); a
    gap of the time stamps tells. Position noise 20 um (chosen: a fifth of the arm's stated repeatability).
    """

    Settings: ClassVar[type[DeviceSettings]] = Ur5Settings
    model = "Universal Robots UR5, CB3 (simulated)"

    def __init__(self, name: str, settings: Ur5Settings, context: DeviceContext) -> None:
        timing = Timing(
            latency_s=0.002, jitter_s=0.0005, lost_share=2e-4,
            clock_offset_s=float(context.rng.uniform(10, 1000)), clock_drift=5e-6,
        )  # fmt: skip
        super().__init__(
            name, settings, context,
            channels=(Channel("position", "m"),), rate_hz=125.0, timing=timing, full_scale=np.array([np.inf]),
        )  # fmt: skip
        self.travel_m = self._limits.travel_m or _REACH_M

    def open(self) -> None:
        """Connect.

        Raises
        ------
        DeviceError
            This bench has no carriage.
        """
        self._require_signals(("position",))
        super().open()

    def position_m(self) -> float:
        """Where the carriage is."""
        self._require_answer()
        return float(self.scene.observe(("position",), np.array([self._clock.now()]))[0, 0])

    def travel(self, to_m: float, speed_m_s: float) -> None:
        """Start a straight move at constant speed.

        Raises
        ------
        LimitExceededError
            Beyond travel or speed: the move is not sent.
        DeviceError
            A speed that is not positive, or no answer.
        """
        self._require_answer()
        if not (np.isfinite(to_m) and np.isfinite(speed_m_s) and speed_m_s > 0):
            raise DeviceError(
                self.name, f"cannot travel to {to_m:g} m at {speed_m_s:g} m/s; the speed is above zero"
            )
        for excess in self._limits.travel_excess(to_m, speed_m_s):
            raise LimitExceededError(
                self.name,
                f"{excess}; the move was not sent",
                hint="change trial.carriage, or the device's limits",
            )
        low, high = self.travel_m
        if not low <= to_m <= high:
            raise LimitExceededError(
                self.name, f"travel to {to_m:g} m leaves {low:g} ... {high:g} m; the move was not sent"
            )
        self.scene.tow(self.position_m(), to_m, speed_m_s, self._clock.now())

    def safe_stop(self) -> None:
        """Stop where it is."""
        super().safe_stop()
        if self.closed or self._scene is None:
            return
        now = self._clock.now()
        here = float(self._scene.observe(("position",), np.array([now]))[0, 0])
        self._scene.tow(here, here, 0.0, now)

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Note the stop where `stop_log` asks for it: a simulated arm ends with its process."""
        settings.log_stop(name, "emergency_stop")

    def _measure(self, time_s: FloatArray) -> FloatArray:
        position = self.scene.observe(("position",), time_s)
        return position + _POSITION_SD_M * self._rng.standard_normal(position.shape)
