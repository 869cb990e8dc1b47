"""Filters that serve inputs and outputs alike: how each treats one straight piece of a signal."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

import math
from collections.abc import Sequence

from labrun.models.native import Pointer

_HEADER = 4
_PIECE = 4
_LONG_AGO_S = -1e300


def gain_error(
    before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer
) -> None:
    """Write ``(1 + error) * signal``."""
    out[0] = (1.0 + values[0]) * before[0]
    out[1] = (1.0 + values[0]) * after[0]


def bias(before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer) -> None:
    """Write ``signal + offset``."""
    out[0] = before[0] + values[0]
    out[1] = after[0] + values[0]


def saturation(
    before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer
) -> None:
    """Write the signal, cut at plus and minus the level."""
    out[0] = min(max(before[0], -values[0]), values[0])
    out[1] = min(max(after[0], -values[0]), values[0])


def rate_limit(
    before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer
) -> None:
    """Write what follows the signal at no more than the rate; `memory` holds it."""
    if dt == 0.0:
        memory[0] = after[0]
    out[0] = memory[0]
    # where the rate does not bind, a jump of the signal between two pieces stays a jump
    if values[0] == math.inf:
        out[0] = before[0]
        memory[0] = after[0]
    elif dt > 0.0:
        step = values[0] * dt
        memory[0] += min(max(after[0] - memory[0], -step), step)
    out[1] = memory[0]


def dead_band(
    before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer
) -> None:
    """Write how far the signal is beyond the band."""
    out[0] = before[0] - min(max(before[0], -values[0]), values[0])
    out[1] = after[0] - min(max(after[0], -values[0]), values[0])


def drift(before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer) -> None:
    """Write ``signal + slope * t``; `memory` holds the time."""
    if dt == 0.0:
        memory[0] = 0.0
    out[0] = before[0] + values[0] * memory[0]
    memory[0] += dt
    out[1] = after[0] + values[0] * memory[0]


def cross_talk(
    before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer
) -> None:
    """Write ``signal + share * other``, where the other is the model's next signal of the same kind."""
    out[0] = before[0] + values[0] * before[1]
    out[1] = after[0] + values[0] * after[1]


def lag(before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer) -> None:
    """Write the exact response of ``time_constant dy/dt = signal - y`` to a straight piece; `memory` holds y."""
    constant = values[0]
    if dt == 0.0:
        memory[0] = after[0]
    out[0] = memory[0]
    if constant <= 0.0:
        out[0] = before[0]
        memory[0] = after[0]
    elif dt > 0.0:
        behind = (after[0] - before[0]) / dt * constant
        memory[0] = after[0] - behind + (memory[0] - before[0] + behind) * math.exp(-dt / constant)
    out[1] = memory[0]


def delay(before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer) -> None:
    """Write what the signal was ``values[0]`` seconds ago, interpolated within the piece it then was in.

    `memory` is the time now, the number of pieces seen, the piece being read, the slots of the ring, and the ring of
    pieces: begin, end, value at the begin, value at the end. Reading only ever moves on, so that a call costs the same
    however long the delay is.
    """
    shift = max(values[0], 0.0)
    if dt == 0.0:
        memory[3] = float((int(memory[0]) - _HEADER) // _PIECE)
        memory[0] = 0.0
        memory[1] = 1.0
        memory[2] = 0.0
        memory[_HEADER] = _LONG_AGO_S  # before the first piece the signal was constant
        memory[_HEADER + 1] = 0.0
        memory[_HEADER + 2] = after[0]
        memory[_HEADER + 3] = after[0]
        out[0] = after[0]
        out[1] = after[0]
        return
    slots = int(memory[3])
    newest = int(memory[1])
    reading = int(memory[2])
    place = _HEADER + _PIECE * (newest % slots)
    memory[place] = memory[0]
    memory[place + 1] = memory[0] + dt
    memory[place + 2] = before[0]
    memory[place + 3] = after[0]
    for end in range(2):
        target = memory[0] + end * dt - shift
        place = _HEADER + _PIECE * (reading % slots)
        # at the begin of a piece what matters is the value after a jump, at its end the value before one
        while reading < newest and (memory[place + 1] < target or (end == 0 and memory[place + 1] == target)):
            reading += 1
            place = _HEADER + _PIECE * (reading % slots)
        fraction = (target - memory[place]) / (memory[place + 1] - memory[place])
        out[end] = (1.0 - fraction) * memory[place + 2] + fraction * memory[place + 3]
    memory[0] += dt
    memory[1] = newest + 1.0
    memory[2] = reading


def delay_memory(values: Sequence[float], shortest_s: float) -> int:
    """Return how many numbers `delay` keeps: a slot for each piece within the delay, and some to spare."""
    return _HEADER + _PIECE * (int(max(values[0], 0.0) / shortest_s) + 4)
