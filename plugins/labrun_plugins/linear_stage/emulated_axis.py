"""The mechanics and the step interrupt of an emulated stage: ramps, end switches, force limit, homing."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

Mode = Literal["still", "to", "run", "brake", "seek", "back"]

STEPS_PER_MM = 1600.0
ACCELERATION_MM_S2 = 200.0
FASTEST_MM_S = 10.0
HOMING_MM_S = 5.0
BACK_OFF_MM = 0.5
"""How far homing backs off its switch; there the count is what it is."""
_TICK_S = 0.001
_DEEPER = 1.05
"""While it backs out of a force beyond its limit it stops anew if the force grows by a twentieth."""


@dataclass
class Axis:
    """A screw with a stepper, two end switches and a count of steps.

    Attributes
    ----------
    stroke_mm
        Between the end switches.
    true_mm
        Where it is, from the lower switch.
    stopped_by
        Told "LOW", "HIGH", "FORCE" or "CELL" (nobody feels the force) when a limit stops it, after it has.
    """

    stroke_mm: float
    true_mm: float
    stopped_by: Callable[[str, float], None]
    mode: Mode = "still"
    homed: bool = False
    force_limit: bool = False
    jammed: bool = False
    pressed: str = ""
    """"LOW" or "HIGH": a switch that reads as pressed, wherever the stage is."""
    soft_mm: tuple[float, float] = (-math.inf, math.inf)
    most_counts: int = 0x7FFFFF
    speed_mm_s: float = 0.0
    _count_from_mm: float = field(init=False)
    _wanted_mm_s: float = 0.0
    _target_mm: float = 0.0
    _tripped_counts: int = 0
    _tripped_sign: float = 0.0
    _now_s: float = 0.0

    def __post_init__(self) -> None:
        self._count_from_mm = self.true_mm  # at power-up it counts from where it happens to be

    @property
    def count_mm(self) -> float:
        """Where it believes to be: the last whole step."""
        return round((self.true_mm - self._count_from_mm) * STEPS_PER_MM) / STEPS_PER_MM

    @property
    def between_mm(self) -> float:
        """Where it believes to be between two steps, by the phase of its step clock."""
        return self._count() if self.moving else self.count_mm

    @property
    def moving(self) -> bool:
        """Whether it moves, or is about to."""
        return self.mode != "still"

    @property
    def at_low(self) -> bool:
        """Whether the lower end switch, or the lower limit it was given, is reached."""
        return self.pressed == "LOW" or self.true_mm <= 0.0 or self._beyond(self.soft_mm[0], -1)

    @property
    def at_high(self) -> bool:
        """Whether the upper end switch, or the upper limit it was given, is reached."""
        return self.pressed == "HIGH" or self.true_mm >= self.stroke_mm or self._beyond(self.soft_mm[1], +1)

    def reset(self, now_s: float) -> None:
        """Power up anew: it forgets where it is."""
        self.halt()
        self.homed = self.force_limit = False
        self.soft_mm, self.most_counts = (-math.inf, math.inf), 0x7FFFFF
        self._count_from_mm = self.true_mm
        self._now_s = now_s

    def may_move(self, sign: float) -> str:
        """Return why it may not move that way: "LOW", "HIGH" or "FORCE"; "" if it may."""
        if sign < 0 and self.at_low:
            return "LOW"
        if sign > 0 and self.at_high:
            return "HIGH"
        return "FORCE" if self.force_limit and sign == self._tripped_sign else ""

    def go(self, target_mm: float, speed_mm_s: float) -> None:
        """Move to a count, at this speed at most."""
        self.mode, self._target_mm, self._wanted_mm_s = "to", target_mm, speed_mm_s

    def run(self, speed_mm_s: float) -> None:
        """Move at a signed speed until something stops it."""
        self.mode, self._wanted_mm_s = ("run" if speed_mm_s else "brake"), speed_mm_s

    def seek(self) -> None:
        """Seek the lower end switch."""
        self.mode, self._wanted_mm_s, self.homed = "seek", -HOMING_MM_S, False

    def brake(self) -> None:
        """Slow down to a stand."""
        if self.moving:
            self.mode, self._wanted_mm_s = "brake", 0.0

    def halt(self) -> None:
        """Stand still at once."""
        self.mode, self.speed_mm_s, self._wanted_mm_s = "still", 0.0, 0.0

    def miss_cell(self, now_s: float) -> None:
        """Stop at once, if there is a force limit: the amplifier gives nothing, so that nobody feels the force."""
        if self.moving and self.most_counts < 0x7FFFFF:
            self.halt()
            self.stopped_by("CELL", now_s)

    def advance(self, now_s: float, counts: int) -> None:
        """Move on to a time, with the latest reading of the load cell in the interrupt."""
        if self._now_s == 0.0 or not self.moving:
            self._now_s = now_s
        if self.force_limit and abs(counts) <= self.most_counts:
            self.force_limit = False
        while self._now_s < now_s and self.moving:
            step_s = min(_TICK_S, now_s - self._now_s)
            self._now_s += step_s
            self._tick(step_s, counts, self._now_s)

    def _tick(self, step_s: float, counts: int, now_s: float) -> None:
        change = self._wanted() - self.speed_mm_s
        most = ACCELERATION_MM_S2 * step_s
        self.speed_mm_s += max(-most, min(most, change))
        way_mm = self.speed_mm_s * step_s
        if self.mode == "to" and abs(self._target_mm - self._count()) <= max(abs(way_mm), 0.5 / STEPS_PER_MM):
            way_mm = self._target_mm - self._count()
            self._shift(way_mm)
            self.halt()
            return
        self._shift(way_mm)
        if self.mode == "back":
            if self.true_mm >= BACK_OFF_MM:
                self._count_from_mm, self.homed = 0.0, True
                self.halt()
            return
        if self.mode == "seek" and (self.true_mm <= 0.0 or self.pressed == "LOW"):
            self.speed_mm_s, self._wanted_mm_s, self.mode = 0.0, 0.2 * HOMING_MM_S, "back"
            return
        if self.mode == "brake" and self.speed_mm_s == 0.0:
            self.halt()
            return
        self._mind(counts, now_s)

    def _mind(self, counts: int, now_s: float) -> None:
        """Stop at once at a switch, a limit or a force, in the sense that leads further."""
        sign = math.copysign(1.0, self.speed_mm_s) if self.speed_mm_s else 0.0
        bound = self.most_counts
        if self.force_limit:
            bound = int(max(bound, _DEEPER * self._tripped_counts))
        which = ""
        if abs(counts) > bound:
            which = "FORCE"
        elif sign < 0 and self.at_low and self.mode != "seek":
            which = "LOW"
        elif sign > 0 and self.at_high:
            which = "HIGH"
        if not which:
            return
        if which == "FORCE":
            self.force_limit, self._tripped_counts, self._tripped_sign = True, abs(counts), sign
        self.halt()
        self.stopped_by(which, now_s)

    def _wanted(self) -> float:
        if self.mode != "to":
            return self._wanted_mm_s
        left_mm = self._target_mm - self._count()
        most = min(self._wanted_mm_s, math.sqrt(2.0 * ACCELERATION_MM_S2 * abs(left_mm)))
        return math.copysign(most, left_mm)

    def _count(self) -> float:
        return self.true_mm - self._count_from_mm

    def _shift(self, way_mm: float) -> None:
        if self.jammed:  # steps without a way: it counts them all the same
            self._count_from_mm -= way_mm
        else:
            self.true_mm += way_mm

    def _beyond(self, bound_mm: float, sign: int) -> bool:
        return self.homed and sign * (self._count() - bound_mm) > 0.5 / STEPS_PER_MM
