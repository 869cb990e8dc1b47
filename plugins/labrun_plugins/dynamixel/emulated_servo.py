"""One emulated servo: its control table, its shaft, what it does with instructions.

The control table of an emulated servo: what stands where, who may write it, and when.

Written from the manual's pages, apart from the host's table.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from labrun.devices import Scene, Trajectory
from labrun.devices.emulation import EmulatorLog
from labrun_plugins.simulated.dynamixel import (
    COUNT_RAD,
    CURRENT_STEP_A,
    SHAFT,
    SPEED_STEP_RAD_S,
    TEMPERATURE_C,
    TORQUE_N_M_A,
    motor_current_a,
)

Access = Literal["read", "eeprom", "ram"]
_MANY = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the manual's table."""

    address: int
    size: int
    access: Access
    start: int
    low: int = 0
    high: int = _MANY


def entries(model: int, firmware: int) -> dict[int, Entry]:
    """Return the lines of a model's table by address.

    Models from 1060 to 1090 and 1160 measure load, and have neither current limit nor goal current.
    """
    lines = [
        Entry(0, 2, "read", model), Entry(2, 4, "read", 0), Entry(6, 1, "read", firmware),
        Entry(7, 1, "eeprom", 1, 0, 252), Entry(8, 1, "eeprom", 1, 0, 7), Entry(9, 1, "eeprom", 250, 0, 254),
        Entry(10, 1, "eeprom", 0, 0, 13), Entry(11, 1, "eeprom", 3, 0, 16), Entry(12, 1, "eeprom", 255, 0, 255),
        Entry(13, 1, "eeprom", 2, 1, 22), Entry(20, 4, "eeprom", 0, -1_044_479, 1_044_479),
        Entry(24, 4, "eeprom", 10, 0, 1023), Entry(31, 1, "eeprom", 80, 0, 100),
        Entry(32, 2, "eeprom", 160, 95, 160), Entry(34, 2, "eeprom", 95, 95, 160),
        Entry(36, 2, "eeprom", 885, 0, 885), Entry(38, 2, "eeprom", 1193, 0, 1193),
        Entry(44, 4, "eeprom", 330, 0, 1023), Entry(48, 4, "eeprom", 4095, 0, 4095),
        Entry(52, 4, "eeprom", 0, 0, 4095), Entry(60, 1, "eeprom", 0, 0, 3), Entry(63, 1, "eeprom", 52, 0, 255),
        Entry(64, 1, "ram", 0, 0, 1), Entry(65, 1, "ram", 0, 0, 1), Entry(68, 1, "ram", 2, 0, 2),
        Entry(69, 1, "read", 0), Entry(70, 1, "read", 0), Entry(76, 2, "ram", 1920, 0, 16383),
        Entry(78, 2, "ram", 100, 0, 16383), Entry(80, 2, "ram", 0, 0, 16383), Entry(82, 2, "ram", 0, 0, 16383),
        Entry(84, 2, "ram", 800, 0, 16383), Entry(88, 2, "ram", 0, 0, 16383), Entry(90, 2, "ram", 0, 0, 16383),
        Entry(98, 1, "ram", 0, 0, 127), Entry(100, 2, "ram", 885, -_MANY), Entry(102, 2, "ram", 1193, -_MANY),
        Entry(104, 4, "ram", 0, -_MANY), Entry(108, 4, "ram", 0, 0, 32767), Entry(112, 4, "ram", 0, 0, 32767),
        Entry(116, 4, "ram", 0, -_MANY), Entry(120, 2, "read", 0), Entry(122, 1, "read", 0),
        Entry(123, 1, "read", 0), Entry(124, 2, "read", 0), Entry(126, 2, "read", 0), Entry(128, 4, "read", 0),
        Entry(132, 4, "read", 0), Entry(136, 4, "read", 0), Entry(140, 4, "read", 0), Entry(144, 2, "read", 120),
        Entry(146, 1, "read", 35), Entry(147, 1, "read", 0),
    ]  # fmt: skip
    lines += [Entry(168 + 2 * n, 2, "ram", 224 + n, 64, 661) for n in range(28)]
    lines += [Entry(578 + 2 * n, 2, "ram", 634 + n, 64, 661) for n in range(28)]
    measures_load = 1060 <= model <= 1090 or model == 1160
    return {line.address: line for line in lines if not (measures_load and line.address in (38, 102))}


def indirect(address: int) -> int | None:
    """Return where the pointer of an indirect data byte stands; None for an ordinary address."""
    if 224 <= address <= 251:
        return 168 + 2 * (address - 224)
    if 634 <= address <= 661:
        return 578 + 2 * (address - 634)
    return None


class Refusal(Exception):  # noqa: N818  named after what the servo does
    """The servo answers with this error number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


RANGE, LENGTH, LIMIT, ACCESS = 4, 5, 6, 7


class Table:
    """The memory of one servo, with the rules of the manual about reading and writing.

    Parameters
    ----------
    model, firmware
        Decide which lines there are.
    """

    def __init__(self, model: int, firmware: int) -> None:
        self.lines = entries(model, firmware)
        self._memory = bytearray(700)
        self._owner = {a + n: line for a, line in self.lines.items() for n in range(line.size)}
        for line in self.lines.values():
            self.set(line.address, line.start)

    def get(self, address: int, *, signed: bool = False) -> int:
        """Return the value of a line."""
        size = self.lines[address].size
        return int.from_bytes(self._memory[address : address + size], "little", signed=signed)

    def set(self, address: int, value: int) -> None:
        """Put a value, without any rule."""
        size = self.lines[address].size
        self._memory[address : address + size] = (value % 256**size).to_bytes(size, "little")

    def restart(self) -> None:
        """Forget everything but what EEPROM keeps."""
        for line in self.lines.values():
            if line.access != "eeprom":
                self.set(line.address, line.start)

    def read(self, address: int, length: int) -> bytes:
        """Return bytes. Raises Refusal: there is nothing at one of these addresses."""
        status_packet = bytearray()
        for index in range(address, address + length):
            target = self._target(index)
            if target not in self._owner:
                raise Refusal(ACCESS)
            status_packet.append(self._memory[target])
        return bytes(status_packet)

    def check(self, address: int, data: bytes) -> list[tuple[Entry, int]]:
        """Return the lines that data would write, and their new values.

        Raises Refusal: read-only, no such address, half a line, EEPROM while the torque is on, or out of range.
        """
        changed = dict(zip((self._target(address + n) for n in range(len(data))), data, strict=True))
        touched: list[Entry] = []
        for register_address in changed:
            line = self._owner.get(register_address)
            if line is None or line.access == "read" or (line.access == "eeprom" and self.get(64)):
                raise Refusal(ACCESS)
            if line not in touched:
                touched.append(line)
        written = []
        for line in touched:
            places = range(line.address, line.address + line.size)
            if any(position not in changed for position in places):
                raise Refusal(LENGTH)
            value = int.from_bytes(bytes(changed[p] for p in places), "little", signed=line.low < 0)
            if not line.low <= value <= line.high:
                raise Refusal(RANGE)
            written.append((line, value))
        return written

    def _target(self, address: int) -> int:
        pointer = indirect(address)
        return address if pointer is None else self.get(pointer)


_STEP_S = 0.005
_EVERY_S = 0.004
"""The scene is told of new goals no more often: it is another process, and goals may come a thousand times a second."""
_FAR_S = 20.0
"""A shaft that spins for longer than this is driven on from where it is."""


class EmulatedShaft:
    """One shaft.

    Parameters
    ----------
    joint
        Of the scene; turned by the servo's angle less `neutral_rad`.
    neutral_rad
        Servo angle at which the joint stands at zero.
    now_s
        Time at which the shaft stands at its neutral angle.
    """

    def __init__(self, joint: str, neutral_rad: float, scene: Scene | None, now_s: float) -> None:
        self._joint = joint
        self._neutral_rad = neutral_rad
        self._scene = scene
        self._time_s = now_s
        self._angle_rad = neutral_rad
        self._speed_rad_s = 0.0
        self._goal_rad: float | None = None
        self._most_rad_s = SHAFT.speed_rad_s
        self._told_s = -math.inf
        self._untold = False
        # Compiled now, and not at the first goal: that takes seconds, in which a servo would be silent.
        SHAFT.motion(joint, Trajectory((joint,), np.zeros(1), np.zeros((1, 1))), 0.0)

    def state(self, now_s: float) -> tuple[float, float, float]:
        """Return angle (rad), speed (rad/s) and acceleration (rad/s^2) of the shaft now."""
        self._advance(now_s)
        return self._angle_rad, self._speed_rad_s, self._acceleration()

    def current_a(self, now_s: float) -> float:
        """Return what the motor draws now."""
        _, speed, acceleration = self.state(now_s)
        return float(motor_current_a(np.array(speed), np.array(acceleration)))

    def go(self, goal_rad: float, most_rad_s: float, now_s: float) -> None:
        """Turn to a goal, no faster than this."""
        if goal_rad == self._goal_rad and most_rad_s == self._most_rad_s:
            return
        self._advance(now_s)
        self._goal_rad, self._most_rad_s = goal_rad, most_rad_s
        self._untold = True
        self.tell(now_s)

    def tell(self, now_s: float) -> float:
        """Tell the scene of the newest goal, if it is time; return when to be called again."""
        if not self._untold or self._goal_rad is None:
            return math.inf
        due_s = self._told_s + _EVERY_S
        if now_s < due_s:
            return due_s
        self._advance(now_s)
        shaft = replace(SHAFT, speed_rad_s=self._most_rad_s)
        goal = Trajectory((self._joint,), np.zeros(1), np.array([[self._goal_rad]]))
        self._turn(shaft.motion(self._joint, goal, self._angle_rad, self._speed_rad_s), now_s)
        self._told_s = now_s
        return math.inf

    def spin(self, speed_rad_s: float, now_s: float) -> None:
        """Turn at a constant speed."""
        self._advance(now_s)
        if speed_rad_s == self._speed_rad_s and self._goal_rad is None:
            return
        self._goal_rad, self._speed_rad_s = None, speed_rad_s
        ends = np.array([[self._angle_rad], [self._angle_rad + _FAR_S * speed_rad_s]])
        self._turn(Trajectory((self._joint,), np.array([0.0, _FAR_S]), ends), now_s)

    def halt(self, now_s: float) -> None:
        """Stand still where it is."""
        self.spin(0.0, now_s)

    def _turn(self, motion: Trajectory, now_s: float) -> None:
        self._untold = False
        if self._scene is not None:
            joint = Trajectory((self._joint,), motion.time_s, motion.angle_rad - self._neutral_rad)
            self._scene.drive(self._joint, joint, now_s)

    def _advance(self, now_s: float) -> None:
        """Solve ``x'' = w^2 (goal - x) - 2 D w x'`` from the last look to now, exactly but for the cut of the speed."""
        while (left_s := now_s - self._time_s) > 0.0:
            step_s = min(left_s, _STEP_S)
            if self._goal_rad is None:
                step_s = left_s
                self._angle_rad += step_s * self._speed_rad_s
            else:
                self._step(step_s, self._goal_rad)
            self._time_s += step_s
            if step_s == left_s:
                self._time_s = now_s

    def _step(self, step_s: float, goal_rad: float) -> None:
        natural = 2.0 * math.pi * SHAFT.natural_hz
        decay = SHAFT.damping * natural
        damped = natural * math.sqrt(1.0 - SHAFT.damping**2)
        cosine, sine = math.cos(damped * step_s), math.sin(damped * step_s) / damped
        fading = math.exp(-decay * step_s)
        error, speed = goal_rad - self._angle_rad, self._speed_rad_s
        next_error = fading * ((cosine + decay * sine) * error - sine * speed)
        next_speed = fading * (natural**2 * sine * error + (cosine - decay * sine) * speed)
        if abs(next_speed) > self._most_rad_s:
            next_speed = math.copysign(self._most_rad_s, next_speed)
            next_error = error - next_speed * step_s
        self._angle_rad, self._speed_rad_s = goal_rad - next_error, next_speed

    def _acceleration(self) -> float:
        if self._goal_rad is None or abs(self._speed_rad_s) >= self._most_rad_s:
            return 0.0
        natural = 2.0 * math.pi * SHAFT.natural_hz
        error = self._goal_rad - self._angle_rad
        return natural**2 * error - 2.0 * SHAFT.damping * natural * self._speed_rad_s


ALERT = 0x80
OVERHEATED, OVERLOADED = 1 << 2, 1 << 5
_CURRENT, _VELOCITY, _POSITION, _EXTENDED, _CURRENT_POSITION, _PWM = 0, 1, 3, 4, 5, 16
_MODES = (_CURRENT, _VELOCITY, _POSITION, _EXTENDED, _CURRENT_POSITION, _PWM)
_GOALS = {100: "pwm", 102: "current", 104: "velocity", 116: "position"}
_TIME_BASED = 4
_TRIPPED = 0xFF
_WATCHDOG_STEP_S = 0.02
_WATCHDOG_FIRMWARE = 38
_RESTART_S = 0.25
_FAILED = 1
_FREE_SPEED = 330


class EmulatedServo:
    """A servo of the X series.

    Parameters
    ----------
    now_s
        When it was switched on.
    """

    def __init__(
        self, joint: str, identity: int, table: Table, shaft: EmulatedShaft, log: EmulatorLog, now_s: float
    ) -> None:
        self.joint = joint
        self.table = table
        self.shaft = shaft
        self._log = log
        self._heard_s = now_s
        self._born_s = now_s
        self._deaf_until_s = -math.inf
        self._registered: tuple[int, bytes] | None = None
        self._cleared = 0
        table.set(7, identity)
        self._goal_here(now_s)

    @property
    def id(self) -> int:
        """Its id."""
        return self.table.get(7)

    @property
    def error(self) -> int:
        """The error byte of a status packet without a refusal."""
        return ALERT if self.table.get(70) else 0

    def awake(self, now_s: float) -> bool:
        """Tell whether it listens: not for a moment after a restart."""
        return now_s >= self._deaf_until_s

    def heard(self, now_s: float) -> None:
        """Note that there was an instruction on the bus, for whomever."""
        self._heard_s = now_s

    def watch(self, now_s: float) -> float:
        """Stop if nothing was heard for too long; return when to look again."""
        steps = self.table.get(98)
        if not steps or steps == _TRIPPED or not self.table.get(64):
            return math.inf
        due_s = self._heard_s + steps * _WATCHDOG_STEP_S
        if now_s < due_s:
            return due_s
        self.trip(now_s)
        return math.inf

    def trip(self, now_s: float) -> None:
        """Stop as the bus watchdog does: the goals are locked until it is cleared."""
        self.table.set(98, _TRIPPED)
        self.table.set(108, 0)
        self.table.set(112, 0)
        self.shaft.halt(now_s)
        self._log.note("watchdog", joint=self.joint, silent_s=now_s - self._heard_s)

    def suffer(self, error: int, now_s: float) -> None:
        """Latch a hardware error, and shut down if its bit is enabled."""
        if self.table.get(70) & error:
            return
        self.table.set(70, self.table.get(70) | error)
        if error & self.table.get(63) and self.table.get(64):
            self.table.set(64, 0)
            self.shaft.halt(now_s)
            self._log.note("shutdown", joint=self.joint, error=error)

    def warm(self, temperature_c: float, now_s: float) -> None:
        """Have this temperature; too much of it is a hardware error."""
        self.table.set(146, round(temperature_c))
        if temperature_c >= self.table.get(31):
            self.suffer(OVERHEATED, now_s)

    def read(self, address: int, length: int, now_s: float) -> bytes:
        """Return bytes as they are now; raises Refusal."""
        self._measure(now_s)
        return self.table.read(address, length)

    def write(self, address: int, data: bytes, now_s: float) -> None:
        """Write bytes, and do what follows from them; raises Refusal, and then nothing has changed."""
        written = self.table.check(address, data)
        for line, value in written:
            self._allow(line, value)
        for line, value in written:
            before = self.table.get(line.address)
            self.table.set(line.address, value)
            self._obey(line.address, value, before, now_s)

    def register(self, address: int, data: bytes) -> None:
        """Keep a write for `act`; raises Refusal."""
        for line, value in self.table.check(address, data):
            self._allow(line, value)
        self._registered = (address, data)
        self.table.set(69, 1)

    def act(self, now_s: float) -> None:
        """Do what was registered."""
        if self._registered is not None:
            address, data = self._registered
            self._registered = None
            self.table.set(69, 0)
            self.write(address, data, now_s)

    def restart(self, now_s: float) -> None:
        """Begin anew: errors are cleared, RAM is as after power-on, and it is deaf for a moment."""
        self.table.restart()
        self.table.set(146, round(TEMPERATURE_C))
        self.shaft.halt(now_s)
        self.clear_turns(now_s)
        self._registered = None
        self._deaf_until_s = now_s + _RESTART_S
        self._goal_here(now_s)
        self._log.note("restart", joint=self.joint)

    def present(self, now_s: float) -> int:
        """Return its count."""
        return 2048 + round(self.shaft.state(now_s)[0] / COUNT_RAD) - self._cleared

    def clear_turns(self, now_s: float) -> None:
        """Forget whole turns: the count is within the first one again; raises Refusal while the shaft moves."""
        if self.shaft.state(now_s)[1]:
            raise Refusal(_FAILED)
        self._cleared += 4096 * (self.present(now_s) // 4096)
        self._goal_here(now_s)

    def _allow(self, line: Entry, value: int) -> None:
        """Refuse what the manual's prose forbids, beside the ranges of the table."""
        if line.address == 11 and value not in _MODES:
            raise Refusal(RANGE)
        if line.address == 98 and self.table.get(6) < _WATCHDOG_FIRMWARE:
            raise Refusal(7)
        if line.address not in _GOALS:
            return
        if self.table.get(98) == _TRIPPED:
            raise Refusal(RANGE)
        mode = self.table.get(11)
        if line.address == 116:
            reach = (self.table.get(52), self.table.get(48)) if mode == _POSITION else (-1_048_575, 1_048_575)
            if not reach[0] <= value <= reach[1]:
                raise Refusal(LIMIT)
        else:
            bound = self.table.get({100: 36, 102: 38, 104: 44}[line.address])
            if abs(value) > bound:
                raise Refusal(LIMIT)

    def _obey(self, address: int, value: int, before: int, now_s: float) -> None:
        if address == 11 and value != before:
            self._new_mode(now_s)
        elif address == 64:
            if value and not before:
                self._goal_speed_zero()
            if not value:
                self.shaft.halt(now_s)
        if self.table.get(64) and (address in _GOALS or address in (64, 112)):
            self._drive(now_s)

    def _new_mode(self, now_s: float) -> None:
        """Reset gains, profile and goals, as a change of the operating mode does."""
        for address in (76, 78, 80, 82, 84, 88, 90):
            self.table.set(address, self.table.lines[address].start)
        for address in (108, 112):
            self.table.set(address, 0)
        self.table.set(100, self.table.get(36))
        if 102 in self.table.lines:
            self.table.set(102, self.table.get(38))
        self._goal_speed_zero()
        self.clear_turns(now_s)

    def _goal_here(self, now_s: float) -> None:
        self.table.set(116, self.present(now_s))

    def _goal_speed_zero(self) -> None:
        self.table.set(104, 0)

    def _drive(self, now_s: float) -> None:
        mode = self.table.get(11)
        if mode in (_POSITION, _EXTENDED, _CURRENT_POSITION):
            most = self.table.get(44)
            profile = self.table.get(112)
            if profile and not self.table.get(10) & _TIME_BASED:
                most = min(most, profile)
            goal_rad = (self.table.get(116, signed=True) + self._cleared - 2048) * COUNT_RAD
            self.shaft.go(goal_rad, most * SPEED_STEP_RAD_S, now_s)
        elif mode == _VELOCITY:
            self.shaft.spin(self.table.get(104, signed=True) * SPEED_STEP_RAD_S, now_s)
        else:
            # Without a load, a motor under constant current or voltage soon turns as fast as it can.
            push = self.table.get(102 if mode == _CURRENT else 100, signed=True)
            share = push / 885 if mode == _PWM else (push > 0) - (push < 0)
            self.shaft.spin(share * _FREE_SPEED * SPEED_STEP_RAD_S, now_s)

    def _effort_step(self) -> float:
        """Return what one step of address 126 is, A; of load, what draws that much."""
        model = self.table.get(0)
        if 102 not in self.table.lines:
            return TORQUE_N_M_A * 1e-3
        if 1190 <= model <= 1240:
            return 1e-3
        return 1.34e-3 if model in (1040, 1050) else CURRENT_STEP_A

    def _measure(self, now_s: float) -> None:
        angle, speed, _ = self.shaft.state(now_s)
        count = 2048 + round(angle / COUNT_RAD) - self._cleared
        moves = abs(speed) / SPEED_STEP_RAD_S > self.table.get(24)
        on = self.table.get(64)
        goal = self.table.get(116, signed=True)
        self.table.set(120, int(1000 * (now_s - self._born_s)) % 32768)
        self.table.set(122, int(moves))
        self.table.set(123, int(abs(goal - count) < 10) if on else 0)
        self.table.set(126, round(self.shaft.current_a(now_s) / self._effort_step()) if on else 0)
        self.table.set(128, round(speed / SPEED_STEP_RAD_S))
        self.table.set(132, count)
        self.table.set(136, round(speed / SPEED_STEP_RAD_S))
        self.table.set(140, goal if on else count)
