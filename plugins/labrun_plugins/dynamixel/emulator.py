"""Dynamixels seen from the wire: several servos on one pty.

Beside the wire's own faults it knows ``wrong-id`` (this many answers bear another servo's id), ``error`` (this many
instructions are refused with ERR 7), ``overheat`` (temperature of the first servo, degC; 85 without a number),
``overcurrent`` (the first servo latches overload), ``stale`` (this many answers are old ones), ``silent-servo`` (the
servo with this id hears, but does not answer), and ``watchdog`` (this many times all servos stop as if nothing had been
heard). What is there is told by ``model``, ``firmware``, ``return-delay`` and ``mode``, looked at once, when it opens.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from labrun.devices.emulated_ports import PtyEndpoint
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.dynamixel import emulated_packets as wire
from labrun_plugins.dynamixel.emulated_bus import Answer, EmulatedBus
from labrun_plugins.dynamixel.emulated_servo import OVERLOADED, EmulatedServo, EmulatedShaft, Table
from labrun_plugins.simulated.dynamixel import TEMPERATURE_C, SimulatedDynamixelSettings
from labrun_plugins.simulated.servo import require_joints

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
        if self._faults.take("watchdog"):
            for servo in self._servos:
                servo.trip(now_s)

    def _mute(self, servo: EmulatedServo) -> bool:
        return self._faults.active("silent-servo") and servo.id == int(self._faults.number("silent-servo"))

    def _refuses(self) -> bool:
        return self._faults.take("error")
