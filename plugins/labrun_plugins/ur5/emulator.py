"""A UR5 seen from its network ports."""

import math
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labrun.devices import DeviceError
from labrun.devices.emulated_ports import TcpEndpoint
from labrun.devices.emulation import EmulatorContext, EmulatorLog, Faults
from labrun_plugins.simulated.ur5 import LOST_SHARE, SimulatedUr5Settings
from labrun_plugins.ur5.emulated_arm import (
    PAUSED,
    PLAYING,
    EmulatedArm,
    Program,
    ScriptError,
    ScriptReader,
    StopL,
    StopProgram,
)

BANNER = "Connected: Universal Robots Dashboard Server"
_ROBOT_MODES = {3: "POWER_OFF", 7: "RUNNING"}
_SAFETY_MODES = {1: "NORMAL", 3: "PROTECTIVE_STOP", 5: "SAFEGUARD_STOP", 7: "ROBOT_EMERGENCY_STOP"}
_SERIAL = "20155300001"
_BRAKE_M_S2 = 2.0
_ACTIONS = ("stop", "pause", "play", "unlock protective stop")
_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect its cause before unlocking"
)


def reply(
    command: str, arm: EmulatedArm, faults: Faults, log: EmulatorLog, version: str, now_s: float
) -> str:
    """Return the answer to one line, and do what it asks for."""
    text = _told(command, arm, faults, version)
    if text is not None:
        return text
    if command in _ACTIONS and faults.active("local-mode"):
        log.note("ignored", what=f"dashboard {command}", why="local control")
        return f"Failed to execute: {command}"
    if command == "stop":
        log.note("stop", how="dashboard", position_m=arm.position_m())
    return _done(command, arm, now_s)


def _done(command: str, arm: EmulatedArm, now_s: float) -> str:
    """Do what a command asks for, and return the answer."""
    answer = f"could not understand: '{command[:80]}'"
    if command == "stop":
        if arm.runtime in (PLAYING, PAUSED):
            arm.stop_program(_BRAKE_M_S2, now_s)
        answer = "Stopped"
    elif command == "pause" and arm.runtime == PLAYING:
        arm.stop_program(_BRAKE_M_S2, now_s, paused=True)
        answer = "Pausing program"
    elif command == "unlock protective stop":
        answer = "Protective stop releasing" if arm.unlock(now_s) else _TOO_EARLY
    elif command in _ACTIONS:
        answer = f"Failed to execute: {command}"
    return answer


def _told(command: str, arm: EmulatedArm, faults: Faults, version: str) -> str | None:
    """Return the answer to a question; None if it is none."""
    remote = not faults.active("local-mode")
    state = {PLAYING: "PLAYING", PAUSED: "PAUSED"}.get(arm.runtime, "STOPPED")
    questions = {
        "robotmode": f"Robotmode: {_ROBOT_MODES[arm.robot_mode]}",
        "safetymode": f"Safetymode: {_SAFETY_MODES[arm.safety_mode]}",
        "safetystatus": f"Safetystatus: {_SAFETY_MODES[arm.safety_mode]}",
        "programState": f"{state} labrun_move",
        "running": f"Program running: {'true' if arm.runtime == PLAYING else 'false'}",
        "PolyscopeVersion": f"URSoftware {version} (Jan 01 2023)",
        "get serial number": _SERIAL,
        "get robot model": "UR5",
        "close safety popup": "closing safety popup",
        "quit": "Disconnected",
    }
    if version.startswith("5."):
        questions["is in remote control"] = "true" if remote else "false"
    return questions.get(command)


_WIDTHS = {
    "BOOL": ("B", 1), "UINT8": ("B", 1), "UINT32": ("I", 1), "UINT64": ("Q", 1), "INT32": ("i", 1),
    "DOUBLE": ("d", 1), "VECTOR3D": ("d", 3), "VECTOR6D": ("d", 6), "VECTOR6INT32": ("i", 6),
    "VECTOR6UINT32": ("I", 6),
}  # fmt: skip
_INPUTS = (
    (re.compile(r"input_int_register_([0-9]|[1-3][0-9]|4[0-7])"), "INT32"),
    (re.compile(r"input_double_register_([0-9]|[1-3][0-9]|4[0-7])"), "DOUBLE"),
    (re.compile(r"speed_slider_mask"), "UINT32"),
    (re.compile(r"speed_slider_fraction"), "DOUBLE"),
    (re.compile(r"standard_digital_output(_mask)?"), "UINT8"),
)
Values = Mapping[str, tuple[str, Any]]


def framed(kind: str, payload: bytes) -> bytes:
    """Return a package."""
    return struct.pack("!Hc", 3 + len(payload), kind.encode()) + payload


def text_message(text: str, source: str, level: int) -> bytes:
    """Return a message of protocol 2."""
    body, origin = text.encode()[:255], source.encode()[:255]
    return framed("M", bytes([len(body)]) + body + bytes([len(origin)]) + origin + bytes([level]))


def pack_values(types: list[str], values: list[Any]) -> bytes:
    """Return values one behind the other."""
    packed = b""
    for kind, value in zip(types, values, strict=True):
        code, count = _WIDTHS[kind]
        packed += struct.pack(f"!{count}{code}", *(value if count > 1 else [value]))
    return packed


def unpack_values(types: list[str], data: bytes) -> list[Any] | None:
    """Return the values of a payload; None if it has another length."""
    layout = "!" + "".join(f"{_WIDTHS[kind][1]}{_WIDTHS[kind][0]}" for kind in types)
    if struct.calcsize(layout) != len(data):
        return None
    flat = list(struct.unpack(layout, data))
    values: list[Any] = []
    for kind in types:
        count = _WIDTHS[kind][1]
        taken, flat = flat[:count], flat[count:]
        values.append(taken[0] if count == 1 else taken)
    return values


@dataclass
class Session:
    """One client of the RTDE port.

    Attributes
    ----------
    owned
        Inputs that any client writes, over all sessions: name -> session.
    write
        Told what this client writes to an input.
    """

    faults: Faults
    log: EmulatorLog
    version: tuple[int, int, int, int]
    known: Callable[[], Values]
    owned: dict[str, "Session"]
    write: Callable[[str, Any], None]
    protocol: int = 1
    started: bool = False
    rate_hz: float = 125.0
    names: list[str] = field(default_factory=list)
    types: list[str] = field(default_factory=list)
    inputs: dict[int, tuple[list[str], list[str]]] = field(default_factory=dict)
    _rest: bytes = b""

    @property
    def most_hz(self) -> float:
        """Rate of the control cycle: 125 Hz on a CB3, 500 Hz on an e-Series."""
        return 500.0 if self.version[0] >= 5 else 125.0

    def feed(self, data: bytes) -> list[bytes] | None:
        """Take what the client sent and return the replies; None if it talks nonsense and has to be dropped."""
        self._rest += data
        replies: list[bytes] = []
        while len(self._rest) >= 3:
            size, kind = struct.unpack("!Hc", self._rest[:3])
            if size < 3:
                return None
            if len(self._rest) < size:
                break
            payload, self._rest = self._rest[3:size], self._rest[size:]
            reply = self._reply(kind.decode("latin-1"), payload)
            if reply is not None:
                replies.append(reply)
        return replies

    def data(self, values: Values) -> bytes:
        """Return the data package of these values."""
        number = b"\x01" if self.protocol == 2 else b""
        return framed("U", number + pack_values(self.types, [values[name][1] for name in self.names]))

    def leave(self) -> None:
        """Give up all inputs."""
        for name in [name for name, owner in self.owned.items() if owner is self]:
            del self.owned[name]

    def _reply(self, kind: str, payload: bytes) -> bytes | None:
        answers = {
            "V": self._negotiate,
            "v": lambda _: framed("v", struct.pack("!4I", *self.version)),
            "O": self._set_outputs,
            "I": self._set_inputs,
            "S": self._start,
            "P": self._pause,
        }
        if kind == "U":
            self._take(payload)
        return answers[kind](payload) if kind in answers else None

    def _start(self, _: bytes) -> bytes:
        self.started = bool(self.names)
        return framed("S", b"\x01" if self.started else b"\x00")

    def _pause(self, _: bytes) -> bytes:
        self.started = False
        return framed("P", b"\x01")

    def _negotiate(self, payload: bytes) -> bytes:
        wanted = struct.unpack("!H", payload)[0] if len(payload) == 2 else 0
        agreed = wanted == 1 or (wanted == 2 and not self.faults.active("no-v2"))
        if agreed:
            self.protocol = wanted
        return framed("V", b"\x01" if agreed else b"\x00")

    def _set_outputs(self, payload: bytes) -> bytes:
        rate = self.most_hz
        if self.protocol == 2:
            if len(payload) < 8:
                return framed("O", b"\x00")
            rate, payload = struct.unpack("!d", payload[:8])[0], payload[8:]
            rate = min(max(rate, 1.0), self.most_hz) if math.isfinite(rate) else self.most_hz
        known = self.known()
        hidden = str(self.faults.value("not-found") or "").split(",")
        names = _names(payload)
        types = [known[n][0] if n in known and n not in hidden else "NOT_FOUND" for n in names]
        good = bool(names) and "NOT_FOUND" not in types
        if good:
            self.names, self.types, self.rate_hz = names, types, rate
        number = b"" if self.protocol == 1 else b"\x01" if good else b"\x00"
        return framed("O", number + ",".join(types).encode())

    def _set_inputs(self, payload: bytes) -> bytes:
        names = _names(payload)
        types = [self._input_type(name) for name in names]
        good = bool(names) and not {"NOT_FOUND", "IN_USE"} & set(types)
        number = len(self.inputs) + 1 if good and len(self.inputs) < 254 else 0
        if number:
            self.inputs[number] = (names, types)
            self.owned.update(dict.fromkeys(names, self))
        return framed("I", bytes([number]) + ",".join(types).encode())

    def _input_type(self, name: str) -> str:
        for pattern, kind in _INPUTS:
            if pattern.fullmatch(name):
                taken = self.faults.active("in-use") or self.owned.get(name, self) is not self
                return "IN_USE" if taken else kind
        return "NOT_FOUND"

    def _take(self, payload: bytes) -> None:
        recipe = self.inputs.get(payload[0]) if payload else None
        values = unpack_values(recipe[1], payload[1:]) if recipe else None
        if recipe is None or values is None:
            self.log.note("rejected", payload=payload[:64])
            return
        for name, value in zip(recipe[0], values, strict=True):
            self.write(name, value)


def _names(payload: bytes) -> list[str]:
    """Return the names of a request; one client in use ends them with a comma."""
    return [name for name in payload.decode("ascii", errors="replace").split(",") if name]


_CB3 = (3, 15, 8, 106339)
_E_SERIES = (5, 11, 1, 108318)
_CLOCK_DRIFT = 5e-6
_STATE_S = 0.1
_BACKLOG_S = 1.0
_STOP_BRAKE_M_S2 = 2.0
_LONGEST_LINE = 4096


class Ur5Emulator:
    """RTDE (protocols 1 and 2), dashboard, and both script ports of one arm.

    Faults besides those of the wire (silence, late, fragment, coalesce, duplicate, ...): ``e-series`` (an e-Series
    controller: 500 Hz, remote control; from the start), ``protective-stop`` (stays until it is cleared and, 5 s after,
    unlocked at the dashboard), ``emergency-stop``, ``safeguard-stop``, ``power-off``, ``speed-slider`` and
    ``speed-scaling`` (0 ... 1), ``local-mode``, ``pendant-stop`` and ``pendant-pause`` (count), ``no-v2``,
    ``not-found`` (names of variables), ``in-use``, ``skip`` (count of packages never sent), ``bad-size`` (count of
    packages with an impossible size), ``restart`` (count: the controller's clock begins anew), ``reset`` (count: all
    connections are reset).

    Log: ``command`` (every move), ``stop`` (by ``stopl``, ``dashboard``, ``stop program`` or ``safety``), ``still``,
    ``watchdog``, ``program error``, ``ignored`` (told something while under local control).

    A loopback address other than 127.0.0.1 as the device's `host` is taken as it is, with the ports of the settings;
    otherwise the ports are free ones of 127.0.0.1.
    """

    def __init__(self, name: str, settings: SimulatedUr5Settings, context: EmulatorContext) -> None:
        self._name = name
        self._settings = settings
        self._context = context
        self._faults = context.faults
        self._log = context.log
        self._arm = EmulatedArm(context, settings.origin_m, settings.direction, settings.orientation_rad)
        self._version = _E_SERIES if context.faults.active("e-series") else _CB3
        self._period_s = 0.002 if self._version[0] >= 5 else 0.008
        self._offset_s = float(context.rng.uniform(10, 1000))
        self._sessions: dict[int, Session] = {}
        self._owned: dict[str, Session] = {}
        self._lines: dict[int, bytes] = {}
        self._readers: dict[tuple[str, int], ScriptReader] = {}
        self._deaf: set[tuple[str, int]] = set()
        self._next_s = 0.0
        self._state_s = 0.0
        self._cycles = 0
        self._was_protective = False

    def open(self) -> Mapping[str, Any]:
        """Open the four services. Raises DeviceError: this bench has no carriage."""
        scene, now_s = self._context.scene, self._context.clock.now()
        if scene is not None:
            if "position" not in scene.signals:
                shown = ", ".join(sorted(scene.signals))
                raise DeviceError(self._name, "this bench has no position", hint=f"it shows {shown}")
            self._arm.set_position(float(scene.observe(("position",), np.array([now_s]))[0, 0]))
        asked = self._settings.host
        fixed = asked.startswith("127.") and asked != "127.0.0.1"
        host = asked if fixed else "127.0.0.1"
        settings = self._settings
        ports = {
            "rtde": settings.rtde_port,
            "dashboard": settings.dashboard_port,
            "script": settings.script_port,
            "primary": settings.primary_port,
        }
        self._ends = {
            service: TcpEndpoint(self._context, host, port if fixed else 0) for service, port in ports.items()
        }
        ports = {f"{service}_port": end.open() for service, end in self._ends.items()}
        self._next_s = self._state_s = now_s
        return {"host": host, **ports}

    def files(self) -> Sequence[int]:
        """Return what to wait on."""
        return [fd for end in self._ends.values() for fd in end.fds]

    def step(self, now_s: float) -> float:
        """Take what arrived, move the arm on, send what is due."""
        if self._faults.take("reset"):
            self._reset()
        if self._faults.take("restart"):
            self._offset_s = -now_s
        self._hear_rtde(now_s)
        self._hear_dashboard(now_s)
        for service in ("script", "primary"):
            self._hear_scripts(service, now_s)
        if now_s - self._next_s > _BACKLOG_S:
            self._next_s = now_s  # this process was held up: those packages were never made
        while self._next_s <= now_s:
            self._cycle(self._next_s, now_s)
            self._next_s += self._period_s
        if now_s >= self._state_s:
            self._state_s = now_s + _STATE_S
            self._tell_state()
        return min(self._next_s, *(end.flush(now_s) for end in self._ends.values()))

    def close(self) -> None:
        """Close all services."""
        for end in self._ends.values():
            end.close()

    def _cycle(self, time_s: float, now_s: float) -> None:
        self._arm.cycle(time_s, now_s)
        self._cycles += 1
        if self._faults.take("skip") or self._context.rng.random() < LOST_SHARE:
            return
        protective = self._arm.safety_mode == 3
        values = None
        for client, session in self._sessions.items():
            if protective and not self._was_protective and session.protocol == 2:
                self._ends["rtde"].send(client, text_message("Protective stop", "Safety", 2))
            if not session.started or self._cycles % max(1, round(session.most_hz / session.rate_hz)):
                continue
            if values is None:
                values = self._arm.values((time_s + self._offset_s) * (1 + _CLOCK_DRIFT))
            package = session.data(values)
            if self._faults.take("bad-size"):
                package = struct.pack("!H", 1) + package[2:]
            self._ends["rtde"].send(client, package)
        self._was_protective = protective

    def _hear_rtde(self, now_s: float) -> None:
        end = self._ends["rtde"]

        def write(name: str, value: Any) -> None:
            self._arm.refresh(name, now_s)
            if name == "speed_slider_fraction" and isinstance(value, float) and math.isfinite(value):
                self._arm.set_slider(value)

        for client in end.accept():
            self._sessions[client] = Session(
                self._faults, self._log, self._version, lambda: self._arm.values(0.0), self._owned, write
            )
        for client in set(self._sessions) - set(end.clients):  # dropped because it read nothing any more
            self._sessions.pop(client).leave()
        for client, data in end.receive():
            session = self._sessions[client]
            session.write = write  # of this moment
            replies = session.feed(data) if data else None
            if replies is None:
                session.leave()
                del self._sessions[client]
                end.drop(client)
                continue
            for text in replies:
                end.send(client, text)

    def _hear_dashboard(self, now_s: float) -> None:
        end = self._ends["dashboard"]
        version = ".".join(str(part) for part in self._version)
        for client in end.accept():
            self._lines[client] = b""
            end.send(client, BANNER.encode() + b"\n")
        for client, data in end.receive():
            if not data:
                self._lines.pop(client, None)
                continue
            *lines, rest = (self._lines[client] + data).split(b"\n")
            self._lines[client] = rest[-_LONGEST_LINE:]
            for line in lines:
                command = line.decode("utf-8", errors="replace").strip()
                answer = reply(command, self._arm, self._faults, self._log, version, now_s)
                end.send(client, answer.encode() + b"\n")

    def _hear_scripts(self, service: str, now_s: float) -> None:
        end = self._ends[service]
        local = self._faults.active("local-mode")
        for client in end.accept():
            self._readers[service, client] = ScriptReader()
            end.send(client, _version_message(self._version))
        if local:  # connections from before the switch back stay deaf
            self._deaf |= {(service, client) for client in end.clients}
        for client, data in end.receive():
            key = (service, client)
            if not data:
                self._readers.pop(key, None)
                self._deaf.discard(key)
                continue
            if key in self._deaf:
                self._log.note("ignored", what=data[:200].decode("utf-8", "replace"), why="local control")
                continue
            for heard in self._readers[key].feed(data):
                self._obey(heard, service, now_s)

    def _obey(self, heard: Program | ScriptError | StopProgram, service: str, now_s: float) -> None:
        position_m = self._arm.position_m()
        if isinstance(heard, StopProgram):
            if service != "primary":
                self._complain(1, 1, "syntax error")
                return
            self._log.note("stop", how="stop program", position_m=position_m)
            self._arm.stop_program(_STOP_BRAKE_M_S2, now_s)
        elif isinstance(heard, ScriptError):
            self._complain(heard.line, heard.column, heard.text)
        else:
            if any(isinstance(statement, StopL) for statement in heard.statements):
                self._log.note("stop", how="stopl", position_m=position_m)
            wrong = self._arm.execute(heard, now_s)
            if wrong:
                self._complain(1, 1, wrong)

    def _complain(self, line: int, column: int, text: str) -> None:
        self._log.note("program error", line=line, column=column, text=text)
        body = struct.pack("!ii", line, column) + text.encode()
        self._tell("primary", _message(10, body))

    def _tell(self, service: str, package: bytes) -> None:
        for client in self._ends[service].clients:
            self._ends[service].send(client, package)

    def _tell_state(self) -> None:
        """Send the state at 10 Hz: of its contents only the outermost frame, which is what clients skip by."""
        for service in ("script", "primary"):
            self._tell(service, struct.pack("!IB", 5, 16))

    def _reset(self) -> None:
        for end in self._ends.values():
            for client in end.clients:
                end.drop(client, reset=True)
        for session in self._sessions.values():
            session.leave()
        self._sessions.clear()
        self._lines.clear()
        self._readers.clear()
        self._deaf.clear()
        self._log.note("reset")


def _message(kind: int, body: bytes) -> bytes:
    """Return a message of the primary port."""
    return struct.pack("!IBQbB", 15 + len(body), 20, 0, -1, kind) + body


def _version_message(version: tuple[int, int, int, int]) -> bytes:
    name = b"URControl"
    major, minor, bugfix, build = version
    return _message(3, bytes([len(name)]) + name + struct.pack("!BBii", major, minor, bugfix, build))
