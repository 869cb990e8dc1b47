"""Stand-in for a UR5 arm (CB3) that carries the specimen along a straight line."""

from typing import ClassVar

import numpy as np

from labrun.devices import DeviceContext, DeviceSettings, FloatArray
from labrun.errors import LimitExceededError
from labrun_plugins.simulated.device import SimulatedCarriage, SimulatedSettings
from labrun_plugins.simulated.sensor import SimulatedSensor, Timing
from labrun_plugins.ur5.motion import Line
from labrun_plugins.ur5.settings import ACCELERATION_M_S2, REACH_M, SPEED_SHARE, Ur5Settings, channels_of

POSITION_SD_M = 2e-5
LOST_SHARE = 2e-4
_TURN_SD_RAD = 1e-5
_SPEED_SD_M_S = 2e-4
HOME = (-0.35, -0.4, 0.3, 0.0, 3.14, 0.0)
"""Tool pose at position zero where the file gives none: 0.8 m along x from there are within reach."""
_SPEED_STEP_S = 0.004
"""The scene tells positions; speed is their difference over half a period."""


class SimulatedUr5Settings(Ur5Settings, SimulatedSettings):
    """Keys of the arm; those of its network and its watchdog mean nothing here."""


class SimulatedUr5(SimulatedCarriage, SimulatedSensor):
    """Carriage, and sensor of its own position at 125 Hz with the controller's time stamps.

    125 Hz is the RTDE rate of a CB3 controller, which now and then skips a package (chosen: one in 5000); a
    gap of the time stamps tells. Position noise 20 um (chosen: a fifth of the arm's stated repeatability), speed noise
    0.2 mm/s and orientation noise 10 urad (chosen).
    """

    Settings: ClassVar[type[DeviceSettings]] = SimulatedUr5Settings
    model = "Universal Robots UR5, CB3 (simulated)"

    def __init__(self, name: str, settings: SimulatedUr5Settings, context: DeviceContext) -> None:
        timing = Timing(
            latency_s=0.002, jitter_s=0.0005, lost_share=LOST_SHARE,
            clock_offset_s=float(context.rng.uniform(10, 1000)), clock_drift=5e-6,
        )  # fmt: skip
        channels = channels_of(settings)
        super().__init__(
            name, settings, context,
            channels=channels, rate_hz=settings.rate_hz or 125.0, timing=timing,
            full_scale=np.full(len(channels), np.inf),
        )  # fmt: skip
        self.travel_m = self._limits.travel_m or REACH_M
        self._line = Line.through(HOME, settings.direction, settings.origin_m, settings.orientation_rad)
        self._tool_channels = settings.tool_channels
        self._speed_m_s = 0.0

    def travel(self, to_m: float, speed_m_s: float, acceleration_m_s2: float = ACCELERATION_M_S2) -> None:
        """Start a straight move at constant speed.

        Raises
        ------
        LimitExceededError
            Beyond travel or speed: the move is not sent.
        DeviceError
            A speed that is not positive, or no answer.
        """
        self._check_travel(to_m, speed_m_s)
        low, high = self.travel_m
        if not low <= to_m <= high:
            raise LimitExceededError(
                self.name, f"travel to {to_m:g} m leaves {low:g} ... {high:g} m; the move was not sent"
            )
        self._speed_m_s = speed_m_s
        # what scenes have by themselves
        ramps = () if acceleration_m_s2 == ACCELERATION_M_S2 else (acceleration_m_s2,)
        self.scene.tow(self.position_m(), to_m, speed_m_s, self._clock.now(), *ramps)

    def _measure(self, time_s: FloatArray) -> FloatArray:
        if not self._tool_channels:
            position = self.scene.observe(("position",), time_s)
            return position + POSITION_SD_M * self._rng.standard_normal(position.shape)
        # Both ends of a short step, one behind the other, since the scene is asked in the order of time.
        step_s = min(_SPEED_STEP_S, 0.5 / self.rate_hz)
        times = np.column_stack([time_s - step_s, time_s]).ravel()
        before, position = self.scene.observe(("position",), times)[:, 0].reshape(-1, 2).T
        return self._with_tool(position, (position - before) / step_s)

    def _with_tool(self, position_m: FloatArray, speed_m_s: FloatArray) -> FloatArray:
        """Return all channels of positions and true speeds along the line, shape (n, channels)."""
        count, noise = len(position_m), self._rng.standard_normal((len(position_m), 7))
        rows = np.empty((count, len(self.channels)))
        point = self._line.origin_m + position_m[:, None] * self._line.direction
        rows[:, 1:4] = point + POSITION_SD_M * noise[:, :3]
        rows[:, 0] = (rows[:, 1:4] - self._line.origin_m) @ self._line.direction
        rows[:, 4:7] = self._line.orientation_rad + _TURN_SD_RAD * noise[:, 3:6]
        rows[:, 7] = speed_m_s
        rows[:, 8] = speed_m_s + _SPEED_SD_M_S * noise[:, 6]
        rows[:, 9] = 1.0
        constant = np.abs(np.abs(speed_m_s) - self._speed_m_s) <= SPEED_SHARE * self._speed_m_s
        rows[:, 10] = constant & (self._speed_m_s > 0.0)
        return rows
