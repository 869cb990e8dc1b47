"""One move, from the order to the arrival: whether it began, is at its speed, and got there."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from labrun_plugins.ur5.settings import SPEED_SHARE
from labrun_plugins.ur5.state import PAUSED, ArmState

ARRIVED_M = 1e-3
_BEGIN_S = 1.5
"""There is no acknowledgement of a program: one that has not begun by then will not."""
_REPLACED_S = 0.5
"""For this long after the order, a program that ends is the one from before."""
_REDUCED_S = 0.2
"""Speed scaling may dip for a cycle or two; this long is somebody's slider."""
FULL = 1e-3
"""Speed scaling and slider count as full this close to 1."""

Phase = Literal["sent", "running", "arrived", "ended", "not begun", "paused"]


@dataclass
class Move:
    """A move that was ordered, followed package by package.

    Attributes
    ----------
    from_m, to_m, speed_m_s
        As ordered.
    sent_s
        Host time of the order.
    phase
        How far it is; ``ended`` short of its goal, ``not begun`` and ``paused`` are failures.
    stopped_m
        Where it ended.
    samples, constant
        How many packages tell of the move, and how many of those of its constant-speed part.
    scaling
        Reduced speed scaling that lasted; 1 if there was none.
    """

    from_m: float
    to_m: float
    speed_m_s: float
    sent_s: float
    phase: Phase = "sent"
    stopped_m: float = 0.0
    samples: int = 0
    constant: int = 0
    scaling: float = 1.0
    _reduced_since_s: float | None = None

    def at_speed(self, state: ArmState) -> bool:
        """Tell whether a package is of the constant-speed part: target speed within 0.5 %, nothing scaled."""
        speed = float(np.linalg.norm(state.target_twist[:3]))
        return (
            abs(speed - self.speed_m_s) <= SPEED_SHARE * self.speed_m_s
            and abs(state.speed_scaling - 1.0) < FULL
            and abs(state.slider - 1.0) < FULL
        )

    def follow(self, state: ArmState, position_m: float) -> bool:
        """Take a package into account; return whether it is of the constant-speed part."""
        if self.phase not in ("sent", "running"):
            return False
        since_s = state.host_s - self.sent_s
        if state.runtime in PAUSED:
            self._end("paused", position_m)
            return False
        if not state.program_runs:
            near = abs(position_m - self.to_m) <= ARRIVED_M
            if self.phase == "running" and since_s > _REPLACED_S:
                self._end("arrived" if near else "ended", position_m)
            elif since_s > _BEGIN_S:
                self._end("arrived" if near else "not begun", position_m)
            elif near:
                self._end("arrived", position_m)
            return False
        self.phase = "running"
        self._watch_scaling(state)
        constant = self.at_speed(state)
        self.samples += 1
        self.constant += constant
        return constant

    def _watch_scaling(self, state: ArmState) -> None:
        if state.speed_scaling > 1.0 - FULL:
            self._reduced_since_s = None
        elif self._reduced_since_s is None:
            self._reduced_since_s = state.host_s
        elif state.host_s - self._reduced_since_s > _REDUCED_S:
            self.scaling = min(self.scaling, state.speed_scaling)

    def _end(self, phase: Phase, position_m: float) -> None:
        self.phase = phase
        self.stopped_m = position_m
