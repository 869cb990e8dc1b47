"""The handful of URScript that the emulator understands, read from text; anything else is a fault of the program."""

import math
import re
from dataclasses import dataclass, field
from typing import NamedTuple

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
            found = self._take(line[:_LONGEST_LINE].decode("utf-8", errors="replace").strip())
            if found is not None:
                heard.append(found)
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
        pose = tuple(float(one) for one in match[1].split(","))
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
    sound = all(math.isfinite(one) for one in numbers) and all(one > 0 for one in positive)
    return statement if sound else None
