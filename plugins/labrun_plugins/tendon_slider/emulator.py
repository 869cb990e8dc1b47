"""A slider on an emulated board: its servo pulls, its spring pushes, its switches close at both ends."""

import math
from collections.abc import Sequence

import numpy as np

from labrun.devices import Scene, Trajectory
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.arduino_servo.emulator import ServoBoardEmulator
from labrun_plugins.tendon_slider.changeover import SLIDER
from labrun_plugins.tendon_slider.settings import KIND, TendonSliderSettings

_END = 0.02
"""Of its way: so near to an end its switch closes."""


class TendonSliderEmulator(ServoBoardEmulator):
    """A board with `labslider`, and a slider that follows its tendon.

    Faults: ``stuck`` (the slider gets no farther than this share of its way; 0.5 if it is just there), those of
    `ServoBoardEmulator` (``overcurrent``), of `EmulatedBoard` (``watchdog``, ``restart``, ``error``, ``wrong-id``,
    ``stale``) and of the wire.
    """

    def __init__(self, name: str, settings: TendonSliderSettings, context: EmulatorContext) -> None:
        super().__init__(name, context, kind=KIND, channels=settings.channel + 1, switches=self._closed)
        self._settings = settings
        self._pulled = 0.0
        self._reached = math.inf

    def pulsed(self, channel: int, pulse_us: int, now_s: float) -> None:
        """Let the slider follow its tendon."""
        if channel == self._settings.channel:
            self._pulled = self._settings.pulled(pulse_us)
            self._slide(now_s)

    def released(self, channel: int, now_s: float) -> None:
        """Let the spring win: a servo without pulses does not hold the tendon."""
        if channel == self._settings.channel:
            self._pulled = 0.0
            self._slide(now_s)

    def _place(self) -> float:
        stuck = self.context.faults.value("stuck")
        most = math.inf if not stuck else 0.5 if stuck is True else float(stuck)
        return min(self._pulled, most)

    def _closed(self) -> Sequence[bool]:
        self._look()
        position_m = min(self._place(), self._reached)
        return (position_m <= _END, position_m >= 1.0 - _END)

    def _slide(self, now_s: float) -> None:
        position_m, scene = self._place(), self.context.scene
        self.note("slider", position=position_m)
        if scene is not None and SLIDER in scene.joints:
            motion = Trajectory((SLIDER,), np.zeros(1), np.array([[position_m]]))
            self.bench.do(lambda: scene.drive(SLIDER, motion, now_s))

    def _look(self) -> None:
        """Have it found out how far the bench's own slider gets: it may be stuck there."""
        scene = self.context.scene
        if scene is not None and SLIDER in scene.signals:
            self.bench.do(lambda: self._found(scene))

    def _found(self, scene: Scene) -> None:
        at_s = np.array([self.context.clock.now()])
        self._reached = float(scene.observe((SLIDER,), at_s)[0, 0])
