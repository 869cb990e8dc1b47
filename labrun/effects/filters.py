"""Effects without an equation: delay, exact lag, rate limit and motion profile of a signal, and wall echo."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

import math
from collections.abc import Sequence

from labrun.compiled import Pointer

_HEADER = 4
_PIECE = 4
_LONG_AGO_S = -1e300
_SECTIONS = 4
"""Pade approximations of an echo's delay."""


def rate_limit(
    before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer
) -> None:
    """Limit the rate of a signal; `memory` holds the output."""
    if dt == 0.0:
        memory[0] = after[0]
    out[0] = memory[0]
    # where the rate does not bind, a jump of the signal between two pieces stays a jump
    if values[0] == math.inf:
        out[0] = before[0]
        memory[0] = after[0]
    elif dt > 0.0:
        step = values[0] * dt
        ahead, slope = before[0] - memory[0], (after[0] - before[0]) / dt
        memory[0] += min(max(after[0] - memory[0], -step), step)
        closing = abs(values[0] - math.copysign(slope, ahead * slope))
        if memory[0] == after[0] and abs(ahead) < closing * dt:  # the signal is caught up with, and followed
            caught = abs(ahead) / closing
            out[2] = 0.5 * ahead * (1.0 - caught / dt)
    out[1] = memory[0]


def motion_profile(
    before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer
) -> None:
    """Follow a signal time-optimally with bounded speed and acceleration.

    `memory` is where it is, and its speed. It goes to where the piece of the signal ends: a drive follows goals that
    are held. Phases of constant acceleration: until the top speed, at it, and until rest.
    """
    if dt == 0.0:
        memory[0] = after[0]
        memory[1] = 0.0
    position, speed, top = memory[0], memory[1], values[0]
    out[0] = position
    if top == math.inf:
        out[0] = before[0]
        memory[0] = after[0]
        memory[1] = 0.0
    elif dt > 0.0:
        slope = top / values[1]
        # where it would come to rest if it braked now, tells the way
        short = after[0] - position - 0.5 * speed * abs(speed) / slope
        way = 1.0 if short >= 0.0 else -1.0
        ahead, along = way * (after[0] - position), way * speed
        peak = min(math.sqrt(max(slope * ahead + 0.5 * along * along, 0.0)), top)
        first = abs(peak - along) / slope
        last = peak / slope
        between = ahead - 0.5 * (along + peak) * first - 0.5 * peak * last
        cruise = max(between, 0.0) / peak if peak > 0.0 else 0.0
        area, left = 0.0, dt
        for phase in range(3):
            length = first if phase == 0 else cruise if phase == 1 else last
            rising = math.copysign(slope, peak - along) if phase == 0 else 0.0 if phase == 1 else -slope
            spent = min(length, left)
            area += spent * (position + way * spent * (0.5 * along + rising * spent / 6.0))
            position += way * spent * (along + 0.5 * rising * spent)
            left -= spent
            if spent < length:
                along += rising * spent
                break
            along = peak if phase < 2 else 0.0
        if left > 0.0:
            position, along = after[0], 0.0
            area += left * position
        memory[0] = position
        memory[1] = way * along
        out[2] = area / dt - 0.5 * (out[0] + position)
    out[1] = memory[0]


def motion_profile_memory(values: Sequence[float], shortest_s: float) -> int:
    """Return how many numbers `motion_profile` keeps."""
    return 2


def play(before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer) -> None:
    """Apply play (backlash) to a signal; `memory` holds the output."""
    half = 0.5 * values[0]
    if dt == 0.0:
        memory[0] = after[0]
    memory[0] = min(max(memory[0], before[0] - half), before[0] + half)
    out[0] = memory[0]
    memory[0] = min(max(memory[0], after[0] - half), after[0] + half)
    out[1] = memory[0]


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
        vanishing, rest = memory[0] - before[0] + behind, math.exp(-dt / constant)
        memory[0] = after[0] - behind + vanishing * rest
        out[2] = vanishing * (constant / dt * (1.0 - rest) - 0.5 * (1.0 + rest))
    out[1] = memory[0]


def ahead(before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer) -> None:
    """Extrapolate the signal linearly by ``values[0]`` seconds."""
    further = values[0] * (after[0] - before[0]) / dt if dt > 0.0 else 0.0
    out[0] = before[0] + further
    out[1] = after[0] + further


def delay(before: Pointer, after: Pointer, dt: float, values: Pointer, memory: Pointer, out: Pointer) -> None:
    """Delay the signal by ``values[0]`` seconds, interpolated within its piece.

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
    slot = _HEADER + _PIECE * (newest % slots)
    memory[slot] = memory[0]
    memory[slot + 1] = memory[0] + dt
    memory[slot + 2] = before[0]
    memory[slot + 3] = after[0]
    pieces, area, since, value = 0, 0.0, 0.0, 0.0
    for end in range(2):
        target = memory[0] + end * dt - shift
        slot = _HEADER + _PIECE * (reading % slots)
        # at the begin of a piece what matters is the value after a jump, at its end the value before one
        while reading < newest and (memory[slot + 1] < target or (end == 0 and memory[slot + 1] == target)):
            if end == 1:  # what is read lies in more than one piece
                area += 0.5 * (value + memory[slot + 3]) * (memory[slot + 1] - since)
                pieces += 1
                since = memory[slot + 1]
            reading += 1
            slot = _HEADER + _PIECE * (reading % slots)
            if end == 1:
                value = memory[slot + 2]
        fraction = (target - memory[slot]) / (memory[slot + 1] - memory[slot])
        out[end] = (1.0 - fraction) * memory[slot + 2] + fraction * memory[slot + 3]
        if end == 0:
            since, value = target, out[0]
        elif pieces > 0:
            area += 0.5 * (value + out[1]) * (target - since)
            out[2] = area / dt - 0.5 * (out[0] + out[1])
    memory[0] += dt
    memory[1] = newest + 1.0
    memory[2] = reading


def delay_memory(values: Sequence[float], shortest_s: float) -> int:
    """Return how many numbers `delay` keeps: a slot for each piece within the delay, and some to spare."""
    return _HEADER + _PIECE * (int(max(values[0], 0.0) / shortest_s) + 4)


def wall_echo(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``coefficient`` times what ``|rate| rate`` was `delay` ago.

    Four Pade approximations of second order, each of a quarter of the delay, one behind the other: right to 1 % of the
    phase up to an angular frequency of 7 / delay.
    """
    part = values[1] / _SECTIONS
    signal = abs(rate) * rate
    for section in range(_SECTIONS):
        index = 2 * section
        dz[index] = z[index + 1]
        dz[index + 1] = signal - 12.0 / (part * part) * z[index] - 6.0 / part * z[index + 1]
        signal -= 12.0 / part * z[index + 1]
    return values[0] * signal
