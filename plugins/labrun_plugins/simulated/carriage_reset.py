"""Stand-in for a servo and pulley that pull a carriage back to its start."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from labrun.devices import DeviceContext, DeviceSettings, Scene, Trajectory
from labrun_plugins.carriage_reset.driver import LINE, check_move, line_motion
from labrun_plugins.carriage_reset.settings import CarriageResetSettings
from labrun_plugins.simulated.device import SimulatedCarriage, SimulatedDevice, SimulatedSettings

_TAUT_M = 1e-6


class SimulatedCarriageResetSettings(CarriageResetSettings, SimulatedSettings):
    """Keys of the winch, and of every simulated device."""


class SimulatedCarriageReset(SimulatedCarriage):
    """A line of commanded length: it pulls the bench's carriage once it is taut, and never pushes it."""

    Settings: ClassVar[type[DeviceSettings]] = SimulatedCarriageResetSettings
    model = "servo and pulley (simulated)"

    def __init__(self, name: str, settings: SimulatedCarriageResetSettings, context: DeviceContext) -> None:
        super().__init__(name, settings, context)
        self.travel_m = settings.travel_m
        self._settings = settings
        self._line = Trajectory((LINE,), np.zeros(1), np.array([[self.travel_m[1]]]))
        self._start_s = 0.0

    def position_m(self) -> float:
        """Return the length of line, m."""
        self._require_answer()
        return self._length_m(self._clock.now())

    def travel(self, to_m: float, speed_m_s: float) -> None:
        """Wind the line up or pay it out; see the driver.

        Raises
        ------
        LimitExceededError
            Beyond travel or speed: the move is not sent.
        DeviceError
            A speed that is not positive, or no answer.
        """
        self._require_answer()
        check_move(self.name, self._settings, to_m, speed_m_s)
        now_s = self._clock.now()
        from_m = self._length_m(now_s)
        self._line, self._start_s = line_motion(self._settings, from_m, to_m, speed_m_s), now_s
        if to_m < from_m:
            pull(self.scene, from_m, to_m, speed_m_s, now_s)

    def safe_stop(self) -> None:
        """Hold the line, and with it the carriage that it pulls."""
        SimulatedDevice.safe_stop(self)
        if self.closed or self._scene is None:
            return
        now_s = self._clock.now()
        here_m = self._length_m(now_s)
        winding = self._length_m(now_s + 1e-3) < here_m
        self._line, self._start_s = Trajectory((LINE,), np.zeros(1), np.array([[here_m]])), now_s
        if winding:
            hold(self._scene, now_s)

    def snapshot(self) -> dict[str, Any]:
        """Return the line's motion as JSON-ready values, so that a resumed run goes on identically."""
        return {
            "start_s": self._start_s,
            "time_s": self._line.time_s.tolist(),
            "line_m": self._line.angle_rad[:, 0].tolist(),
        }

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take back what `snapshot` gave; the bench restores its own memory of the carriage."""
        self._start_s = float(snapshot["start_s"])
        lines_m = np.array(snapshot["line_m"], dtype=float)[:, None]
        self._line = Trajectory((LINE,), np.array(snapshot["time_s"], dtype=float), lines_m)

    def _length_m(self, time_s: float) -> float:
        return float(self._line.at(time_s - self._start_s)[0, 0])


def pull(scene: Scene, from_m: float, to_m: float, speed_m_s: float, start_s: float) -> None:
    """Wind a line up at constant speed: from when it is taut, the bench's carriage comes along."""
    here_m = _carriage_m(scene, start_s)
    if here_m > to_m + _TAUT_M:
        slack_m = max(from_m - here_m, 0.0)
        scene.tow(here_m, to_m, speed_m_s, start_s + slack_m / speed_m_s)


def hold(scene: Scene, now_s: float) -> None:
    """Stop the carriage where it is."""
    here_m = _carriage_m(scene, now_s)
    scene.tow(here_m, here_m, 0.0, now_s)


def _carriage_m(scene: Scene, time_s: float) -> float:
    return float(scene.observe(("position",), np.array([time_s]))[0, 0])
