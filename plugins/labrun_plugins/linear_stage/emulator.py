"""The stage seen from the wire: a ``labstage`` board with its screw and its load cell, on a simulated bench."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from labrun.devices import DeviceError, Scene, Trajectory
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.labline.board import EmulatedBoard, LineMachine, RefusalError, Word, decimal, whole
from labrun_plugins.simulated.linear_stage import LoadCell, SimulatedLinearStageSettings

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
        """Tell whether it moves, or is about to."""
        return self.mode != "still"

    @property
    def at_low(self) -> bool:
        """Tell whether the lower end switch, or the lower limit it was given, is reached."""
        return self.pressed == "LOW" or self.true_mm <= 0.0 or self._beyond(self.soft_mm[0], -1)

    @property
    def at_high(self) -> bool:
        """Tell whether the upper end switch, or the upper limit it was given, is reached."""
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
            self.true_mm += way_mm
            self.halt()
            return
        self.true_mm += way_mm
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

    def _beyond(self, bound_mm: float, sign: int) -> bool:
        return self.homed and sign * (self._count() - bound_mm) > 0.5 / STEPS_PER_MM


FIRMWARE = "1.0"
_CONVERSION_S = 0.0125
"""An HX711 at 80 samples a second."""
_PATIENCE = 3
"""After so many conversions that did not come, the amplifier counts as gone."""
_FASTEST_SAMPLES_HZ = 80.0
_MOST = 0x7FFFFF
_LEAST = -0x800000
_LOOK_S = 0.005
_JOINT = "pusher"


class LinearStageEmulator(EmulatedBoard):
    """A ``labstage`` on its bench: what it does to the pusher is felt by the load cell.

    Faults, besides those of `EmulatedBoard`: ``saturate`` (the cell reads 7FFFFF; with the value "unflagged" without
    the flag, which the driver has to notice), ``overload`` (so many N more on the cell), ``not-ready`` (the amplifier
    gives nothing), ``end-switch`` ("low" or "high" reads as pressed), ``jam`` (steps without a way), ``wrap`` (the
    microseconds wrap so many seconds from now), ``skip`` (so many samples are left out).
    """

    def __init__(self, name: str, settings: SimulatedLinearStageSettings, context: EmulatorContext) -> None:
        super().__init__(name, context)
        self._zero_mm = settings.zero_mm
        self._cell = LoadCell(settings)
        self._axis = Axis(settings.stroke_mm, settings.zero_mm, self._stopped_by)
        self._counts = 0
        self._n = 0
        self._every = 0
        """So many conversions make a sample; 0 while none are sent."""
        self._conversion = 0
        self._ready_s = 0.0
        self._missed = 0
        self._micros_ahead = 0
        self._told: tuple[float, float] = (math.nan, math.nan)
        self._was_moving = False
        self.machine = LineMachine(
            "labstage", FIRMWARE, 1, f"{_FASTEST_SAMPLES_HZ:04.0f}",
            {
                "HOME": Word(self._home, moves=True),
                "MV": Word(self._move, (2, 2), moves=True),
                "VEL": Word(self._run, (1, 1), moves=True),
                "STR": Word(self._stream, (1, 1)),
                "LIM": Word(self._limit, (3, 3)),
                "ST": Word(self._state),
            },
            moving=lambda: self._axis.moving, make_safe=self._make_safe, note=self.note,
        )  # fmt: skip

    @property
    def _scene(self) -> Scene:
        if self.context.scene is None:
            raise DeviceError(
                self.name, "an emulated stage needs a simulated bench", hint='[rig] scene = "beam-bench"'
            )
        return self.context.scene

    def open(self) -> Mapping[str, Any]:
        """Plug it in; return its port."""
        self._ready_s = self.context.clock.now()
        return super().open()

    def advance(self, now_s: float) -> float:
        """Convert what is due, and move on; return when the next conversion or look is."""
        self._suffer(now_s)
        while self._ready_s <= now_s:
            self._axis.advance(self._ready_s, self._counts)
            self._convert(self._ready_s)
            self._ready_s += _CONVERSION_S
            if now_s - self._ready_s > 1.0:  # it was kept from running: no use in making it all up
                self._ready_s = now_s
        self._axis.advance(now_s, self._counts)
        self._push(now_s)
        moving = self._axis.moving
        if self._was_moving and not moving:
            self.note("still", position_mm=self._axis.count_mm, homed=self._axis.homed)
        self._was_moving = moving
        return min(self._ready_s, now_s + _LOOK_S if moving else math.inf)

    def reset(self, now_s: float) -> None:
        """Power up anew."""
        self._axis.reset(now_s)
        self._every = self._n = self._conversion = 0
        self._micros_ahead = 0

    def _convert(self, ready_s: float) -> None:
        """Let the amplifier be ready: position and counts are latched at this edge."""
        ready = not self.context.faults.active("not-ready")
        streamed = self._every > 0
        self._conversion += 1
        due = streamed and self._conversion % self._every == 0
        if ready and (due or self._axis.moving or self._conversion % 8 == 0):
            self._counts = self._read(ready_s)
        self._missed = 0 if ready else self._missed + 1
        if self._missed > _PATIENCE:
            self._axis.miss_cell(ready_s)
        if not due:
            return
        self._n = (self._n + 1) % 2**32
        if self.context.faults.take("skip"):
            return
        self.send(
            self.machine.sample(
                str(self._n), str((self.machine.micros(ready_s) + self._micros_ahead) % 2**32),
                f"{self._axis.between_mm:.5f}", str(self._counts), str(self._flags()),
            )
        )  # fmt: skip

    def _read(self, time_s: float) -> int:
        faults = self.context.faults
        if faults.active("saturate"):
            return _MOST
        force_n = self._scene.observe(("force",), np.array([time_s]))[:, 0] + faults.number("overload")
        return int(self._cell.counts(force_n, self.context.rng)[0])

    def _flags(self) -> int:
        axis, faults = self._axis, self.context.faults
        saturated = not _LEAST < self._counts < _MOST and faults.value("saturate") != "unflagged"
        bits = (
            axis.moving, axis.homed, axis.at_low, axis.at_high, axis.force_limit, saturated,
            faults.active("not-ready"), self.machine.tripped,
        )  # fmt: skip
        return sum(1 << bit for bit, is_set in enumerate(bits) if is_set)

    def _push(self, now_s: float) -> None:
        """Tell the bench how the pusher goes on, when that has changed."""
        speed_m_s = 1e-3 * self._axis.speed_mm_s
        end_mm = self._axis.stroke_mm if speed_m_s > 0 else 0.0
        if (speed_m_s, end_mm) == self._told and self._axis.moving:
            return
        here_m = 1e-3 * (self._axis.true_mm - self._zero_mm)
        if speed_m_s == 0.0:
            if self._told == (0.0, here_m):
                return
            self._told = (0.0, here_m)
            path = Trajectory((_JOINT,), np.zeros(1), np.array([[here_m]]))
        else:
            self._told = (speed_m_s, end_mm)
            way_m = 1e-3 * (end_mm - self._axis.true_mm)
            duration_s = max(way_m / speed_m_s, 1e-3)
            path = Trajectory((_JOINT,), np.array([0.0, duration_s]), np.array([[here_m], [here_m + way_m]]))
        self._scene.drive(_JOINT, path, now_s)

    def _suffer(self, now_s: float) -> None:
        faults = self.context.faults
        self._axis.pressed = str(faults.value("end-switch") or "").upper()
        if faults.active("wrap"):
            left_us = int(1e6 * faults.number("wrap"))
            faults.set("wrap", None)
            self._micros_ahead = 2**32 - left_us - self.machine.micros(now_s)

    def _stopped_by(self, which: str, now_s: float) -> None:
        self.note("stop", how=which, position_mm=self._axis.count_mm, counts=self._counts, at_s=now_s)
        self.send(self.machine.event("LIMIT", which))

    def _make_safe(self, how: str, now_s: float) -> None:
        del now_s
        self.note("stop", how=how, position_mm=self._axis.count_mm, moving=self._axis.moving)
        if how == "STOP":
            self._axis.brake()
        else:
            self._axis.halt()

    def _home(self, _args: Sequence[str], _now_s: float) -> Sequence[str]:
        self.note("command", word="HOME")
        self._axis.seek()
        return ()

    def _move(self, args: Sequence[str], _now_s: float) -> Sequence[str]:
        target_mm, speed_mm_s = decimal(args[0]), decimal(args[1])
        self._require_homed()
        low, high = self._axis.soft_mm
        if not low <= target_mm <= high:
            raise RefusalError("RANGE", "0")
        if not 0.0 < speed_mm_s <= FASTEST_MM_S:
            raise RefusalError("RANGE", "1")
        self._require_free(target_mm - self._axis.count_mm)
        self.note("command", word="MV", position_mm=target_mm, speed_mm_s=speed_mm_s)
        self._axis.go(target_mm, speed_mm_s)
        return ()

    def _run(self, args: Sequence[str], _now_s: float) -> Sequence[str]:
        speed_mm_s = decimal(args[0])
        self._require_homed()
        if abs(speed_mm_s) > FASTEST_MM_S:
            raise RefusalError("RANGE", "0")
        self._require_free(speed_mm_s)
        self.note("command", word="VEL", speed_mm_s=speed_mm_s)
        self._axis.run(speed_mm_s)
        return ()

    def _stream(self, args: Sequence[str], _now_s: float) -> Sequence[str]:
        rate_hz = decimal(args[0])
        if rate_hz != 0.0 and not 1.0 <= rate_hz <= _FASTEST_SAMPLES_HZ:
            raise RefusalError("RANGE", "0")
        self._every = 0 if rate_hz == 0.0 else max(1, round(_FASTEST_SAMPLES_HZ / rate_hz))
        self._conversion = 0
        return ()

    def _limit(self, args: Sequence[str], _now_s: float) -> Sequence[str]:
        low_mm, high_mm, most = decimal(args[0]), decimal(args[1]), whole(args[2])
        if low_mm >= high_mm:
            raise RefusalError("RANGE", "1")
        if not 0 < most <= _MOST:
            raise RefusalError("RANGE", "2")
        self.note("limits", low_mm=low_mm, high_mm=high_mm, most_counts=most)
        self._axis.soft_mm, self._axis.most_counts = (low_mm, high_mm), most
        return ()

    def _state(self, _args: Sequence[str], now_s: float) -> Sequence[str]:
        position = f"{self._axis.count_mm:.5f}"
        return (str(self._flags()), position, str(self._counts), str(self.machine.millis(now_s)))

    def _require_homed(self) -> None:
        if not self._axis.homed:
            raise RefusalError("STATE", "HOME")

    def _require_free(self, way_mm: float) -> None:
        which = self._axis.may_move(math.copysign(1.0, way_mm) if way_mm else 0.0)
        if which:
            raise RefusalError("LIMIT", which)
