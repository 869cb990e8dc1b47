"""Dynamixels seen from the wire: several servos on one pty, and what they do with an instruction."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from labrun.devices.emulated_ports import PtyEndpoint
from labrun.devices.emulation import EmulatorContext, EmulatorLog
from labrun_plugins.dynamixel import emulated_packets as wire
from labrun_plugins.dynamixel.emulated_packets import Instruction
from labrun_plugins.dynamixel.emulated_servo import OVERLOADED, EmulatedServo, EmulatedShaft, Refusal, Table
from labrun_plugins.simulated.dynamixel import TEMPERATURE_C, SimulatedDynamixelSettings
from labrun_plugins.simulated.servo import require_joints

_UNKNOWN_INSTRUCTION, _BAD_CHECKSUM, _BAD_LENGTH = 2, 3, 5
_CLEAR_TURNS = b"\x01DXL\x22"
_FAST_FIRMWARE = 45
_PROFILE = 108
_FACTORY_DEFAULTS = {0xFF: (), 0x01: (7,), 0x02: (7, 8)}


@dataclass(frozen=True, slots=True)
class Answer:
    """A status packet, and when it leaves: each servo waits for its return delay, and for those before it."""

    packet: bytes
    leaves_s: float
    servo: EmulatedServo | None


class EmulatedBus:
    """Servos on one line.

    Parameters
    ----------
    mute
        Tells whether a servo does not answer though it hears.
    refuse
        Tells whether a servo answers with an error, though there is no reason.
    """

    def __init__(
        self,
        servos: Sequence[EmulatedServo],
        mute: Callable[[EmulatedServo], bool],
        refuse: Callable[[], bool],
        log: EmulatorLog,
    ) -> None:
        self.servos = list(servos)
        self._mute = mute
        self._refuse = refuse
        self._log = log

    def handle(self, instruction: Instruction, now_s: float) -> list[Answer]:
        """Carry out an instruction; return the answers."""
        listening = [servo for servo in self.servos if servo.awake(now_s)]
        if not instruction.sound:
            return self._each_own(instruction, listening, now_s, lambda _: (_BAD_CHECKSUM, b""))
        for servo in listening:
            servo.heard(now_s)
        match instruction.code:
            case wire.SYNC_READ | wire.BULK_READ | wire.FAST_SYNC_READ | wire.FAST_BULK_READ:
                return self._group_read(instruction, listening, now_s)
            case wire.SYNC_WRITE | wire.BULK_WRITE:
                self._group_write(instruction, listening, now_s)
                return []
            case _:
                return self._each_own(
                    instruction, listening, now_s, lambda servo: self._single(servo, instruction, now_s)
                )

    def _each_own(
        self,
        instruction: Instruction,
        listening: Sequence[EmulatedServo],
        now_s: float,
        do: Callable[[EmulatedServo], tuple[int, bytes]],
    ) -> list[Answer]:
        """Let the servos that are meant carry out an instruction; a broadcast is answered if it is a ping."""
        everybody = instruction.id == wire.EVERYBODY
        answers: list[Answer] = []
        leaves_s = now_s
        for servo in sorted(listening, key=lambda candidate: candidate.id):
            own, shadow = servo.id == instruction.id, servo.table.get(12) == instruction.id
            if not (own or shadow or everybody):
                continue
            level = servo.table.get(68)
            error, data = do(servo)
            asks = instruction.code == wire.PING
            if (everybody and not asks) or (shadow and not own and not everybody) or self._mute(servo):
                continue
            if not asks and (level == 0 or (level == 1 and instruction.code != wire.READ)):
                continue
            leaves_s += 2e-6 * servo.table.get(9)
            answers.append(Answer(wire.status_packet(servo.id, servo.error | error, data), leaves_s, servo))
        return answers

    def _single(self, servo: EmulatedServo, instruction: Instruction, now_s: float) -> tuple[int, bytes]:
        """Carry out one servo's instruction; return error number and data."""
        if instruction.code != wire.PING and self._refuse():
            return 7, b""
        given = instruction.parameters
        data = b""
        try:
            match instruction.code:
                case wire.PING:
                    data = servo.table.read(0, 2) + servo.table.read(6, 1)
                case wire.READ:
                    data = servo.read(_u16(given, 0), _u16(given, 2), now_s)
                case wire.WRITE:
                    self._write(servo, _u16(given, 0), given[2:], now_s)
                case wire.REG_WRITE:
                    servo.register(_u16(given, 0), given[2:])
                case wire.ACTION:
                    servo.act(now_s)
                case _:
                    self._serve(servo, instruction, now_s)
        except Refusal as refusal:
            self._log.note(
                "refused", joint=servo.joint, code=instruction.code, error=refusal.number, given=given
            )
            return refusal.number, b""
        return 0, data

    def _serve(self, servo: EmulatedServo, instruction: Instruction, now_s: float) -> None:
        """Carry out what concerns the servo as a whole; raises Refusal."""
        given = instruction.parameters
        match instruction.code:
            case wire.REBOOT:
                servo.restart(now_s)
            case wire.FACTORY_RESET if given[:1] and given[0] in _FACTORY_DEFAULTS:
                self._to_factory(servo, _FACTORY_DEFAULTS[given[0]], now_s)
            case wire.CLEAR if given == _CLEAR_TURNS:
                servo.clear_turns(now_s)
            case wire.BACKUP:
                pass  # nothing here outlives the emulator
            case wire.CLEAR | wire.FACTORY_RESET:
                raise Refusal(_BAD_LENGTH)
            case _:
                raise Refusal(_UNKNOWN_INSTRUCTION)

    def _group_read(
        self, instruction: Instruction, listening: Sequence[EmulatedServo], now_s: float
    ) -> list[Answer]:
        """Answer a sync or bulk read in the order of its list; a fast one in one packet."""
        wanted = _wanted(instruction)
        fast = instruction.code in (wire.FAST_SYNC_READ, wire.FAST_BULK_READ)
        there = {servo.id: servo for servo in listening}
        answers: list[Answer] = []
        blocks: list[tuple[int, int, bytes]] = []
        leaves_s = now_s
        for identity, address, length in wanted:
            servo = there.get(identity)
            if servo is None or self._mute(servo) or servo.table.get(68) == 0:
                break  # those after it wait for its answer
            if fast and servo.table.get(6) < _FAST_FIRMWARE:
                break
            error, data = 0, b""
            try:
                if self._refuse():
                    raise Refusal(7)
                data = servo.read(address, length, now_s)
            except Refusal as refusal:
                error = refusal.number
            if fast:
                data = data or bytes(length)
                leaves_s = max(leaves_s, now_s + 2e-6 * servo.table.get(9))
                blocks.append((identity, servo.error | error, data))
            else:
                leaves_s += 2e-6 * servo.table.get(9)
                answers.append(
                    Answer(wire.status_packet(identity, servo.error | error, data), leaves_s, servo)
                )
        if fast and blocks and len(blocks) == len(wanted):
            answers.append(Answer(wire.fast_status_packet(blocks), leaves_s, None))
        return answers

    def _group_write(
        self, instruction: Instruction, listening: Sequence[EmulatedServo], now_s: float
    ) -> None:
        held: dict[str, int] = {}
        there = {servo.id: servo for servo in listening}
        for identity, address, data in _writes(instruction):
            servo = there.get(identity)
            if servo is None:
                continue
            try:
                self._write(servo, address, data, now_s)
            except Refusal as refusal:
                self._log.note(
                    "refused", joint=servo.joint, address=address, error=refusal.number, given=data
                )
                continue
            if address == _PROFILE and data[:8] == bytes(8) and len(data) == 12 and servo.table.get(64):
                held[servo.joint] = int.from_bytes(data[8:], "little", signed=True)
        if held:  # no profile, and a goal, in one packet: that is how a stop is said
            self._log.note("stop", how="hold", counts=held)

    def _write(self, servo: EmulatedServo, address: int, data: bytes, now_s: float) -> None:
        torque = servo.table.get(64)
        servo.write(address, data, now_s)
        if address in (64, 100, 102, 104, 116):
            value = int.from_bytes(data, "little", signed=address != 64)
            self._log.note(
                "command", joint=servo.joint, address=address, value=value, torque=servo.table.get(64)
            )
        if torque and not servo.table.get(64):
            self._log.note("stop", how="torque-off", joint=servo.joint)

    def _to_factory(self, servo: EmulatedServo, kept: tuple[int, ...], now_s: float) -> None:
        values = {address: servo.table.get(address) for address in kept}
        for line in servo.table.lines.values():
            servo.table.set(line.address, values.get(line.address, line.start))
        servo.restart(now_s)


def _u16(data: bytes, offset: int) -> int:
    return int.from_bytes(data[offset : offset + 2], "little")


def _wanted(instruction: Instruction) -> list[tuple[int, int, int]]:
    """Return (id, address, length) of a group read, in its order."""
    given = instruction.parameters
    if instruction.code in (wire.SYNC_READ, wire.FAST_SYNC_READ):
        return [(identity, _u16(given, 0), _u16(given, 2)) for identity in given[4:]]
    return [(given[n], _u16(given, n + 1), _u16(given, n + 3)) for n in range(0, len(given) - 4, 5)]


def _writes(instruction: Instruction) -> list[tuple[int, int, bytes]]:
    """Return (id, address, data) of a group write, in its order."""
    given = instruction.parameters
    writes = []
    if instruction.code == wire.SYNC_WRITE:
        address, length = _u16(given, 0), _u16(given, 2)
        starts = range(4, len(given) - length, length + 1)
        return [(given[n], address, given[n + 1 : n + 1 + length]) for n in starts]
    n = 0
    while n + 5 <= len(given):
        length = _u16(given, n + 3)
        data = given[n + 5 : n + 5 + length]
        if len(data) < length:
            break
        writes.append((given[n], _u16(given, n + 1), data))
        n += 5 + length
    return writes


_MODEL, _FIRMWARE = 1030, 46
_OVERHEATED_C = 85.0
_STALE_S = 0.2
_LOOK_S = 0.05
_KEPT = 256


class DynamixelEmulator:
    """A bus of XM430-W210, one servo a joint of the settings."""

    def __init__(self, name: str, settings: SimulatedDynamixelSettings, context: EmulatorContext) -> None:
        self._name = name
        self._settings = settings
        self._context = context
        self._faults = context.faults
        self._endpoint = PtyEndpoint(context, name, settings.baud)
        self._reader = wire.InstructionReader()
        self._servos: list[EmulatedServo] = []
        self._bus = EmulatedBus([], self._mute, self._refuses, context.log)
        self._waiting: deque[Answer] = deque()
        self._sent: deque[tuple[float, int, bytes]] = deque(maxlen=_KEPT)

    def open(self) -> Mapping[str, Any]:
        """Switch the servos on; return the port by which they are reached.

        Raises DeviceError: the bench has no joint of that name.
        """
        if self._context.scene is not None:
            require_joints(self._name, tuple(self._settings.joints), self._context.scene)
        now = self._context.clock.now()
        model = int(self._faults.value("model") or _MODEL)
        firmware = int(self._faults.value("firmware") or _FIRMWARE)
        for joint, keys in self._settings.joints.items():
            table = Table(model, firmware)
            for name, address in (("return-delay", 9), ("mode", 11)):
                if self._faults.active(name):
                    table.set(address, int(self._faults.number(name)))
            shaft = EmulatedShaft(joint, math.radians(keys.neutral_deg), self._context.scene, now)
            self._servos.append(EmulatedServo(joint, keys.id, table, shaft, self._context.log, now))
        self._bus.servos = self._servos
        path = self._endpoint.open()
        self._context.log.note("open", joints=list(self._settings.joints), model=model, firmware=firmware)
        return {"port": path}

    def files(self) -> Sequence[int]:
        """Return what to wait on."""
        return self._endpoint.fds

    def step(self, now_s: float) -> float:
        """Carry out what arrived, send what is due; return when to be called again."""
        for instruction in self._reader.feed(self._endpoint.receive()):
            self._waiting.extend(self._bus.handle(instruction, now_s))
        self._afflict(now_s)
        watch_s = min(
            (min(servo.watch(now_s), servo.shaft.tell(now_s)) for servo in self._servos), default=math.inf
        )
        while self._waiting and self._waiting[0].leaves_s <= now_s:
            self._send(self._waiting.popleft(), now_s)
        next_s = self._waiting[0].leaves_s if self._waiting else math.inf
        return min(next_s, watch_s, self._endpoint.flush(now_s), now_s + _LOOK_S)

    def close(self) -> None:
        """Switch off."""
        self._endpoint.close()

    def _send(self, answer: Answer, now_s: float) -> None:
        packet = answer.packet
        if answer.servo is not None:
            identity = answer.servo.id
            if self._faults.active("stale"):
                packet = self._old(identity, packet, now_s)
            if self._faults.take("wrong-id"):
                packet = wire.status_packet((identity + 1) % 253, 0, packet[9:-2])
            self._sent.append((now_s, identity, answer.packet))
        self._endpoint.send(packet)

    def _old(self, identity: int, packet: bytes, now_s: float) -> bytes:
        """Return this servo's latest answer of the same length that is old; the new one if there is none."""
        for sent_s, sender, old in reversed(self._sent):
            if sender == identity and len(old) == len(packet) and sent_s < now_s - _STALE_S:
                self._faults.take("stale")
                return old
        return packet

    def _afflict(self, now_s: float) -> None:
        first = self._servos[0]
        if self._faults.active("overheat"):
            value = self._faults.value("overheat")
            first.warm(_OVERHEATED_C if value is True else float(value), now_s)
        elif first.table.get(146) != round(TEMPERATURE_C):
            first.warm(TEMPERATURE_C, now_s)
        if self._faults.active("overcurrent"):
            first.suffer(OVERLOADED, now_s)
        if self._faults.take("restart"):  # the supply was gone for a moment
            for servo in self._servos:
                servo.restart(now_s)
        if self._faults.take("watchdog"):
            for servo in self._servos:
                servo.trip(now_s)

    def _mute(self, servo: EmulatedServo) -> bool:
        return self._faults.active("silent-servo") and servo.id == int(self._faults.number("silent-servo"))

    def _refuses(self) -> bool:
        return self._faults.take("error")
