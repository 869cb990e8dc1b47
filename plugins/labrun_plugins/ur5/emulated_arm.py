"""The emulated arm: how its tool moves, its program, its modes, and what the scene's carriage hangs on."""

import math
import re
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from labrun.devices import FloatArray, Scene
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.simulated.ur5 import HOME, POSITION_SD_M
from labrun_plugins.ur5.settings import ACCELERATION_M_S2

ROUNDING_S = 0.05
"""An arm's acceleration does not jump: it takes this long to rise and to fall (chosen, as the simulated benches do)."""


@dataclass(frozen=True)
class StraightMove:
    """From one pose to another: up to speed at `acceleration`, cruise, down again; lower where the way is short.

    Where it is, is the mean over the last `rounding_s` of where it would be with sharp ramps; 0 leaves them sharp.
    """

    from_pose: FloatArray
    to_pose: FloatArray
    speed_m_s: float
    acceleration_m_s2: float
    rounding_s: float = ROUNDING_S

    @property
    def way_m(self) -> float:
        """Length of the way."""
        return float(np.linalg.norm(self.to_pose[:3] - self.from_pose[:3]))

    @property
    def duration_s(self) -> float:
        """Time from rest to rest."""
        top = self._top_m_s()
        return 0.0 if top == 0.0 else self.way_m / top + top / self.acceleration_m_s2 + self.rounding_s

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Return pose and velocity (6 each) this long after the start."""
        way = self.way_m
        if way == 0.0 or time_s >= self.duration_s:
            return self.to_pose.copy(), np.zeros(6)
        summed, gone, speed = self._sharp(time_s)
        if self.rounding_s > 0.0:
            summed_before, gone_before, _ = self._sharp(time_s - self.rounding_s)
            gone, speed = (summed - summed_before) / self.rounding_s, (gone - gone_before) / self.rounding_s
        along = self.to_pose - self.from_pose
        return self.from_pose + along * (gone / way), along * (speed / way)

    def _sharp(self, time_s: float) -> tuple[float, float, float]:
        """Return the integral of the way over time, the way, and the speed, without rounding."""
        a, top, way = self.acceleration_m_s2, self._top_m_s(), self.way_m
        ramp = top / a
        end = way / top + ramp
        left = end - time_s
        if time_s <= 0.0:
            return 0.0, 0.0, 0.0
        if time_s < ramp:
            return a * time_s**3 / 6.0, 0.5 * a * time_s**2, a * time_s
        if left > ramp:
            cruise = time_s - ramp
            return top * (ramp**2 / 6.0 + 0.5 * cruise * time_s), top * (time_s - 0.5 * ramp), top
        # turned round in time it is the beginning again; half of way times time lies before the middle
        left = max(left, 0.0)
        summed = way * (time_s - 0.5 * end) + a * left**3 / 6.0
        return summed, way - 0.5 * a * left**2, a * left

    def _top_m_s(self) -> float:
        return min(self.speed_m_s, math.sqrt(self.acceleration_m_s2 * self.way_m))


def braking(pose: FloatArray, velocity: FloatArray, deceleration_m_s2: float) -> StraightMove | None:
    """Return the move along which a tool comes to rest; None if it rests already."""
    speed = float(np.linalg.norm(velocity[:3]))
    if speed < 1e-9:
        return None
    way = speed**2 / (2.0 * deceleration_m_s2)
    end = pose + velocity / speed * way
    # The second half of a triangle of speed over twice the way: it begins at full speed, half-way.
    return StraightMove(2.0 * pose - end, end, 2.0 * speed, deceleration_m_s2, rounding_s=0.0)


def half_way_s(move: StraightMove) -> float:
    """Return the time at which a braking move begins."""
    return 0.5 * move.duration_s


_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_HEAD = re.compile(r"(def|sec)\s+([A-Za-z_]\w*)\s*\(\s*\)\s*:")
_MOVEL = re.compile(
    rf"movel\(\s*p\[\s*({_NUMBER}(?:\s*,\s*{_NUMBER}){{5}})\s*\]\s*,\s*a\s*=\s*({_NUMBER})\s*,\s*v\s*=\s*({_NUMBER})\s*\)"
)
_STOPL = re.compile(rf"stopl\(\s*({_NUMBER})\s*\)")
_WATCHDOG = re.compile(
    rf"rtde_set_watchdog\(\s*\"([a-z0-9_]+)\"\s*,\s*({_NUMBER})\s*,\s*\"(ignore|pause|stop)\"\s*\)"
)
_LONGEST_LINE = 4096
_MOST_LINES = 200


class MoveL(NamedTuple):
    """A straight move of the tool."""

    pose: tuple[float, ...]
    acceleration_m_s2: float
    speed_m_s: float


class StopL(NamedTuple):
    """Brake the tool."""

    deceleration_m_s2: float


class SetWatchdog(NamedTuple):
    """Act unless a register is refreshed."""

    register: str
    rate_hz: float
    action: str


Statement = MoveL | StopL | SetWatchdog


class Program(NamedTuple):
    """What is to be executed, one after the other."""

    name: str
    statements: tuple[Statement, ...]


class ScriptError(NamedTuple):
    """Why a program is none."""

    line: int
    column: int
    text: str


class StopProgram(NamedTuple):
    """The plain line ``stop program``."""


Heard = Program | ScriptError | StopProgram


@dataclass
class ScriptReader:
    """Puts programs together from the pieces a client sends."""

    _rest: bytes = b""
    _lines: list[str] | None = field(default=None)

    def feed(self, data: bytes) -> list[Heard]:
        """Return what is complete now."""
        heard: list[Heard] = []
        self._rest += data
        while b"\n" in self._rest:
            line, self._rest = self._rest.split(b"\n", 1)
            answer = self._take(line[:_LONGEST_LINE].decode("utf-8", errors="replace").strip())
            if answer is not None:
                heard.append(answer)
        if len(self._rest) > _LONGEST_LINE:
            self._rest, self._lines = b"", None
            heard.append(ScriptError(1, _LONGEST_LINE, "line too long"))
        return heard

    def _take(self, line: str) -> Heard | None:
        if self._lines is not None:
            return self._take_inside(self._lines, line)
        if not line or line.startswith("#"):
            return None
        if line == "stop program":
            return StopProgram()
        if _HEAD.fullmatch(line):
            self._lines = [line]
            return None
        statement = _statement(line)
        return Program("line", (statement,)) if statement is not None else ScriptError(1, 1, "syntax error")

    def _take_inside(self, lines: list[str], line: str) -> Heard | None:
        lines.append(line)
        if line == "end":
            self._lines = None
            return parsed(lines)
        if len(lines) > _MOST_LINES:
            self._lines = None
            return ScriptError(_MOST_LINES, 1, "program too long")
        return None


def parsed(lines: list[str]) -> Heard:
    """Return the program of lines from ``def`` to ``end``."""
    head = _HEAD.fullmatch(lines[0])
    if head is None:
        return ScriptError(1, 1, "syntax error")
    statements: list[Statement] = []
    for number, line in enumerate(lines[1:-1], start=2):
        if not line or line.startswith("#"):
            continue
        statement = _statement(line)
        if statement is None:
            return ScriptError(number, 1, "syntax error")
        if head[1] == "sec" and not isinstance(statement, SetWatchdog):
            return ScriptError(number, 1, "a secondary program cannot move the robot")
        statements.append(statement)
    return Program(head[2], tuple(statements))


def _statement(line: str) -> Statement | None:
    statement: Statement
    if match := _MOVEL.fullmatch(line):
        pose = tuple(float(part) for part in match[1].split(","))
        statement = MoveL(pose, float(match[2]), float(match[3]))
        numbers = (*pose, statement.acceleration_m_s2, statement.speed_m_s)
        positive = numbers[6:]
    elif match := _STOPL.fullmatch(line):
        statement = StopL(float(match[1]))
        numbers = positive = (statement.deceleration_m_s2,)
    elif match := _WATCHDOG.fullmatch(line):
        statement = SetWatchdog(match[1], float(match[2]), match[3])
        numbers = positive = (statement.rate_hz,)
    else:
        return None
    sound = all(math.isfinite(number) for number in numbers) and all(number > 0 for number in positive)
    return statement if sound else None


_REACH_M = 1.0
_SPEED_SD_M_S = 2e-4
_FORCE_SD_N = 0.5
_UNLOCK_S = 5.0
_PROGRAM_BRAKE_M_S2, _SAFETY_BRAKE_M_S2 = 2.0, 8.0

STOPPING, STOPPED, PLAYING, PAUSED = 0, 1, 2, 4


class EmulatedArm:
    """One arm.

    Parameters
    ----------
    context
        Of the emulator; its scene's carriage is what the tool carries.
    origin, direction, orientation
        The carriage's line in the base frame, as the experiment file has it; None where it leaves that to the pose.
    """

    def __init__(
        self,
        context: EmulatorContext,
        origin: tuple[float, ...] | None,
        direction: tuple[float, ...],
        orientation: tuple[float, ...] | None,
    ) -> None:
        self._faults = context.faults
        self._log = context.log
        self._rng = context.rng
        self._scene: Scene | None = context.scene
        along = np.array(direction, dtype=float)
        self._along = along / np.linalg.norm(along)
        self._origin = np.array([*(origin or HOME[:3]), *(orientation or HOME[3:])], dtype=float)
        self.pose = self._origin.copy()
        self.velocity = np.zeros(6)
        self._statements: list[MoveL | StopL | SetWatchdog] = []
        self._motion: StraightMove | None = None
        self._motion_s = 0.0
        self._factor = 1.0
        self._ending = False
        self._cycle_s: float | None = None
        self._watchdogs: dict[str, tuple[float, str]] = {}
        self._refreshed_s: dict[str, float] = {}
        self._protective_s: float | None = None
        self._slider = 1.0
        self.runtime = STOPPED

    def set_position(self, position_m: float) -> None:
        """Put the tool at a position of the carriage."""
        self.pose = self._origin.copy()
        self.pose[:3] += position_m * self._along

    def position_m(self) -> float:
        """Return where the carriage is."""
        return float((self.pose[:3] - self._origin[:3]) @ self._along)

    def execute(self, program: Program, now_s: float) -> str:
        """Begin a program in place of the one that runs; return what is wrong with it, empty if nothing."""
        if not self.able:
            return "the robot is not running"
        for statement in program.statements:
            if isinstance(statement, MoveL) and np.linalg.norm(statement.pose[:3]) > _REACH_M:
                return "the pose is out of reach"
        if self.moving:  # braked as the program says that takes over, if it begins with that
            first = program.statements[0] if program.statements else None
            self._brake(first.deceleration_m_s2 if isinstance(first, StopL) else _PROGRAM_BRAKE_M_S2, now_s)
        self._watchdogs.clear()
        self._statements = list(program.statements)
        self._ending = False
        self.runtime = PLAYING
        return ""

    def stop_program(self, deceleration_m_s2: float, now_s: float, *, paused: bool = False) -> None:
        """End the program; the tool brakes."""
        self._statements.clear()
        self._watchdogs.clear()
        if self.moving:
            self._brake(deceleration_m_s2, now_s)
        self._ending = True
        self.runtime = PAUSED if paused else STOPPING if self.moving else STOPPED

    def refresh(self, register: str, now_s: float) -> None:
        """Take note that a client has written an input register."""
        self._refreshed_s[register] = now_s

    def set_slider(self, fraction: float) -> None:
        """Set the speed slider."""
        self._slider = min(max(fraction, 0.01), 1.0)

    @property
    def moving(self) -> bool:
        """Tell whether the tool moves."""
        return self._motion is not None

    @property
    def able(self) -> bool:
        """Tell whether it could move: on, and stopped by nothing."""
        return self.robot_mode == 7 and self.safety_mode == 1

    @property
    def robot_mode(self) -> int:
        """3 power off, 7 running."""
        return 3 if self._faults.active("power-off") or self._faults.active("emergency-stop") else 7

    @property
    def safety_mode(self) -> int:
        """1 normal, 3 protective stop, 5 safeguard stop, 7 robot emergency stop."""
        if self._faults.active("emergency-stop"):
            return 7
        if self._protective_s is not None:
            return 3
        return 5 if self._faults.active("safeguard-stop") else 1

    @property
    def safety_bits(self) -> int:
        """As told by `safety_status_bits`."""
        return {1: 0x001, 3: 0x404, 5: 0x410, 7: 0x4C0}[self.safety_mode]

    def unlock(self, now_s: float) -> bool:
        """Release a protective stop; refused within 5 s of it, or while its cause is there."""
        if self._protective_s is None:
            return True
        if now_s - self._protective_s < _UNLOCK_S or self._faults.active("protective-stop"):
            return False
        self._protective_s = None
        self._log.note("unlocked")
        return True

    @property
    def slider(self) -> float:
        """Speed slider, 0 ... 1."""
        return self._faults.number("speed-slider") if self._faults.active("speed-slider") else self._slider

    @property
    def scaling(self) -> float:
        """Speed scaling, 0 ... 1."""
        if self._faults.active("speed-scaling"):
            return self._faults.number("speed-scaling")
        return self.slider

    def cycle(self, time_s: float, now_s: float) -> None:
        """Go on to the next control cycle, which is at `time_s`; `now_s` is when it is computed."""
        step_s = 0.0 if self._cycle_s is None else time_s - self._cycle_s
        self._cycle_s = time_s
        self._look_at_faults(now_s)
        self._look_at_watchdogs(now_s)
        factor = 1.0 if self._ending else self.scaling
        if self._motion is not None:
            if factor != self._factor:
                self._tow(self._motion.to_pose, self._motion.speed_m_s * factor, now_s)
            self._motion_s += step_s * factor
            self.pose, velocity = self._motion.at(self._motion_s)
            self.velocity = velocity * factor
            if self._motion_s >= self._motion.duration_s:
                self._motion = None
                self._log.note("still", position_m=self.position_m())
        self._factor = factor
        while self._motion is None and self._statements:
            self._begin(self._statements.pop(0), now_s)
        if self._motion is None and not self._statements and self.runtime != PAUSED:
            self.runtime = STOPPED
            self._watchdogs.clear()

    def _begin(self, statement: MoveL | StopL | SetWatchdog, now_s: float) -> None:
        if isinstance(statement, SetWatchdog):
            self._watchdogs[statement.register] = (1.0 / statement.rate_hz, statement.action)
            self._refreshed_s[statement.register] = now_s
        elif isinstance(statement, MoveL):
            goal = np.array(statement.pose)
            motion = StraightMove(self.pose, goal, statement.speed_m_s, statement.acceleration_m_s2)
            self._motion, self._motion_s = motion, 0.0
            self._factor = self.scaling
            here_m = self.position_m()
            self._tow(goal, statement.speed_m_s * self._factor, now_s, statement.acceleration_m_s2)
            self._log.note(
                "command",
                what="movel",
                pose=list(statement.pose),
                speed_m_s=statement.speed_m_s,
                acceleration_m_s2=statement.acceleration_m_s2,
                from_m=here_m,
            )

    def _brake(self, deceleration_m_s2: float, now_s: float) -> None:
        speed = float(np.linalg.norm(self.velocity[:3]))
        motion = braking(self.pose, self.velocity, deceleration_m_s2)
        self._motion = motion
        if motion is None:
            self.velocity = np.zeros(6)
            self._tow(self.pose, 0.0, now_s)
            self._log.note("still", position_m=self.position_m())
            return
        self._motion_s = half_way_s(motion)
        self._ending = True
        self._factor = 1.0
        self._tow(motion.to_pose, speed, now_s)

    def _tow(self, goal: FloatArray, speed_m_s: float, now_s: float, *ramps: float) -> None:
        """Have the scene's carriage go along, with the ramps of the move or its own."""
        if self._scene is None:
            return
        here_m = self.position_m()
        there_m = float((goal[:3] - self._origin[:3]) @ self._along)
        ramps = tuple(ramp for ramp in ramps if ramp != ACCELERATION_M_S2)  # what scenes have by themselves
        self._scene.tow(here_m, there_m, speed_m_s, now_s, *ramps)

    def _look_at_faults(self, now_s: float) -> None:
        if self._faults.active("protective-stop") and self._protective_s is None:
            self._protective_s = now_s
            self._log.note("protective stop", position_m=self.position_m())
        if not self.able and self.runtime == PLAYING:
            self._log.note("stop", how="safety", position_m=self.position_m())
            self.stop_program(_SAFETY_BRAKE_M_S2, now_s)
        if self.runtime == PLAYING and self._faults.take("pendant-stop"):
            self.stop_program(_PROGRAM_BRAKE_M_S2, now_s)
        if self.runtime == PLAYING and self._faults.take("pendant-pause"):
            self.stop_program(_PROGRAM_BRAKE_M_S2, now_s, paused=True)

    def _look_at_watchdogs(self, now_s: float) -> None:
        for register, (patience_s, action) in list(self._watchdogs.items()):
            silent_s = now_s - self._refreshed_s[register]
            if silent_s <= patience_s or action == "ignore":
                continue
            self._log.note("watchdog", register=register, silent_s=silent_s, position_m=self.position_m())
            self.stop_program(_PROGRAM_BRAKE_M_S2, now_s, paused=action == "pause")

    def values(self, timestamp_s: float) -> dict[str, tuple[str, Any]]:
        """Return what RTDE tells: name -> type and value."""
        noise = self._rng.standard_normal(15)
        pose, velocity = self.pose, self.velocity
        actual = pose + np.array([*(POSITION_SD_M * noise[:3]), *(1e-5 * noise[3:6])])
        actual_velocity = velocity + _SPEED_SD_M_S * noise[6:12]
        runs = self.runtime == PLAYING
        joints = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
        return {
            "timestamp": ("DOUBLE", timestamp_s),
            "actual_TCP_pose": ("VECTOR6D", actual),
            "target_TCP_pose": ("VECTOR6D", pose),
            "actual_TCP_speed": ("VECTOR6D", actual_velocity),
            "target_TCP_speed": ("VECTOR6D", velocity),
            "actual_TCP_force": ("VECTOR6D", [*(_FORCE_SD_N * noise[12:15]), 0.0, 0.0, 0.0]),
            "actual_q": ("VECTOR6D", joints),
            "actual_qd": ("VECTOR6D", (0.0,) * 6),
            "speed_scaling": ("DOUBLE", self.scaling),
            "target_speed_fraction": ("DOUBLE", self.slider),
            "runtime_state": ("UINT32", self.runtime),
            "robot_mode": ("INT32", self.robot_mode),
            "safety_mode": ("INT32", self.safety_mode),
            "safety_status": ("INT32", self.safety_mode),
            "robot_status_bits": ("UINT32", (1 if self.robot_mode == 7 else 0) | (2 if runs else 0)),
            "safety_status_bits": ("UINT32", self.safety_bits),
            "actual_digital_input_bits": ("UINT64", 0),
        }
