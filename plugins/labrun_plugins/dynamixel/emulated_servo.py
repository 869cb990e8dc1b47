"""One emulated servo: its table, what it does when a line of it is written, and its own safety."""

import math

from labrun.devices.emulation import EmulatorLog
from labrun_plugins.dynamixel.emulated_shaft import EmulatedShaft
from labrun_plugins.dynamixel.emulated_table import LIMIT, RANGE, Entry, Refusal, Table
from labrun_plugins.simulated.dynamixel import (
    COUNT_RAD,
    CURRENT_STEP_A,
    SPEED_STEP_RAD_S,
    TEMPERATURE_C,
    TORQUE_N_M_A,
)

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
    joint
        What it turns, for the log.
    identity
        Its id.
    table, shaft, log
        Its parts.
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
