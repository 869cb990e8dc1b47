"""The wire's own faults, the same for every emulator: what becomes of a message between device and driver."""

import math
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from labrun.devices.clock import Clock
from labrun.devices.emulation import Faults

Target = TypeVar("Target", bound=Hashable)

_BYTE_S = 0.0005
"""Between two bytes of a message that comes in pieces."""


@dataclass
class FaultyWire(Generic[Target]):
    """A queue of messages under way, each with the time at which it arrives.

    Faults it knows: silence, late (s), fragment (each byte alone), coalesce (this many messages at once), corrupt (one
    bit of this many messages), half-frame (this many cut in the middle), truncate (this many short of their last
    byte), drop (share), duplicate and reorder (this many).

    Parameters
    ----------
    clock, rng, faults
        Of the emulator.
    baud
        Bits a second of the wire, ten to a byte: a message arrives when its last byte has; None for no such delay.

    Attributes
    ----------
    arrived
        Messages that have come to the end of the wire so far.
    """

    clock: Clock
    rng: np.random.Generator
    faults: Faults
    baud: float | None = None
    arrived: int = 0
    _under_way: deque[tuple[float, bytes, Target]] = field(default_factory=deque)
    _free_s: float = -math.inf
    _held: tuple[bytes, Target] | None = None
    _gathered: list[tuple[bytes, Target]] = field(default_factory=list)

    def put(self, message: bytes, target: Target) -> None:
        """Send a message on its way, or not, as the faults of the moment have it."""
        faults = self.faults
        if faults.active("silence") or self.rng.random() < faults.number("drop"):
            return
        if faults.take("corrupt"):
            message = self._with_a_bit_flipped(message)
        if faults.take("half-frame"):
            message = message[: len(message) // 2]
        if faults.take("truncate"):
            message = message[:-1]
        if faults.active("coalesce"):
            self._gathered.append((message, target))
            if len(self._gathered) < faults.number("coalesce"):
                return
            message = b"".join(part for part, _ in self._gathered)
            self._gathered.clear()
        if self._held is None and faults.take("reorder"):
            self._held = (message, target)
            return
        self._send(message, target)
        if self._held is not None:
            self._send(*self._held)
            self._held = None
        if faults.take("duplicate"):
            self._send(message, target)

    def due(self, now_s: float) -> list[tuple[bytes, Target]]:
        """Return what arrives up to now."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= now_s:
            _, message, target = self._under_way.popleft()
            self.arrived += 1
            arrived.append((message, target))
        return arrived

    def next_s(self) -> float:
        """Return when the next message arrives; infinite if none is under way."""
        return self._under_way[0][0] if self._under_way else math.inf

    def clear(self) -> None:
        """Lose everything under way."""
        self._under_way.clear()
        self._gathered.clear()
        self._held = None

    def _send(self, message: bytes, target: Target) -> None:
        begin_s = max(self.clock.now() + self.faults.number("late"), self._free_s)
        byte_s = 0.0 if self.baud is None else 10.0 / self.baud
        if self.faults.active("fragment"):
            for number in range(len(message)):
                begin_s += max(byte_s, _BYTE_S)
                self._under_way.append((begin_s, message[number : number + 1], target))
            self._free_s = begin_s
            return
        self._free_s = begin_s + byte_s * len(message)
        self._under_way.append((self._free_s, message, target))

    def _with_a_bit_flipped(self, message: bytes) -> bytes:
        if not message:
            return message
        place = int(self.rng.integers(8 * len(message)))
        flipped = bytearray(message)
        flipped[place // 8] ^= 1 << (place % 8)
        return bytes(flipped)
