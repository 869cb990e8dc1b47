"""A winch on an emulated board: its line pulls the simulated bench's carriage."""

import math

from labrun.devices.emulation import EmulatorContext
from labrun_plugins.arduino_servo.emulator import ServoBoardEmulator
from labrun_plugins.carriage_reset.settings import KIND, CarriageResetSettings
from labrun_plugins.simulated.carriage_reset import hold, pull

_STILL_S = 0.1
"""So long without a shorter line, a pull has ended."""
_SEEN_S = 0.05
"""So long a pull is watched before its speed is known."""
_OTHER_SPEED = 0.2
"""Relative: the bench is told of a speed that differs by more."""


class _Pull:
    """Winding up as the pulses show it: since when, from which length to which, and the speed the bench was told."""

    def __init__(self, since_s: float, from_m: float) -> None:
        self.since_s = since_s
        self.from_m = from_m
        self.line_m = from_m
        self.last_s = since_s
        self.speed_m_s = 0.0


class CarriageResetEmulator(ServoBoardEmulator):
    """A board with `labreset` whose first used channel is a winch.

    The bench moves its carriage at constant speed, and pulses come one at a time: the speed is that of the pulses, and
    where the pull ends is known when they do.

    Faults: those of `ServoBoardEmulator` (``overcurrent``), of `EmulatedBoard` (``watchdog``, ``restart``, ``error``,
    ``wrong-id``, ``stale``) and of the wire.
    """

    def __init__(self, name: str, settings: CarriageResetSettings, context: EmulatorContext) -> None:
        super().__init__(name, context, kind=KIND, channels=settings.channel + 1)
        self._settings = settings
        self._line_m: float | None = None
        self._pull: _Pull | None = None

    def pulsed(self, channel: int, pulse_us: int, now_s: float) -> None:
        """Let the line follow a pulse."""
        if channel != self._settings.channel:
            return
        line_m, before_m = self._settings.line_m(pulse_us), self._line_m
        self._line_m = line_m
        self.note("line", line_m=line_m)
        if before_m is None or line_m >= before_m:
            self._end_pull(now_s)
            return
        if self._pull is None:
            self._pull = _Pull(now_s, line_m)
        self._wind(self._pull, line_m, now_s)

    def released(self, channel: int, now_s: float) -> None:
        """Let go of the line: a servo without pulses holds what little it can."""
        if channel == self._settings.channel:
            self._end_pull(now_s)

    def advance(self, now_s: float) -> float:
        """Find the end of a pull."""
        due_s = super().advance(now_s)
        if self._pull is None:
            return due_s
        if now_s - self._pull.last_s > _STILL_S:
            self._end_pull(now_s)
            return due_s
        return min(due_s, self._pull.last_s + _STILL_S + 1e-3)

    def _wind(self, pull_: _Pull, line_m: float, now_s: float) -> None:
        pull_.last_s, pull_.line_m = now_s, line_m
        passed_s = now_s - pull_.since_s
        if passed_s < _SEEN_S:
            return
        speed_m_s = (pull_.from_m - line_m) / passed_s
        if math.isclose(speed_m_s, pull_.speed_m_s, rel_tol=_OTHER_SPEED):
            return
        pull_.speed_m_s = speed_m_s
        self._tow(line_m, self._settings.travel_m[0], speed_m_s, now_s)

    def _end_pull(self, now_s: float) -> None:
        """Bring the carriage to where the line has ended."""
        ended, self._pull = self._pull, None
        scene = self.context.scene
        if ended is None or scene is None or "position" not in scene.signals:
            return
        if ended.speed_m_s > 0.0:
            self.bench.do(lambda: hold(scene, now_s))
            self._tow(ended.line_m, ended.line_m, ended.speed_m_s, now_s)

    def _tow(self, from_m: float, to_m: float, speed_m_s: float, now_s: float) -> None:
        scene = self.context.scene
        if scene is not None and "position" in scene.signals:
            self.bench.do(lambda: pull(scene, from_m, to_m, speed_m_s, now_s))
