"""The stage seen from the wire: a ``labstage`` board with its screw and its load cell, on a simulated bench."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices import DeviceError, Scene, Trajectory
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.labline.board import EmulatedBoard
from labrun_plugins.labline.device import LineMachine, RefusalError, Word, decimal, whole
from labrun_plugins.linear_stage.emulated_axis import FASTEST_MM_S, Axis
from labrun_plugins.simulated.linear_stage import LoadCell, SimulatedLinearStageSettings

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

    Parameters
    ----------
    name
        The device's name.
    settings
        Of its stand-in.
    context
        Of the emulator.
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
        if speed_m_s == 0.0 or self._axis.jammed:
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
        self._axis.jammed = faults.active("jam")
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
