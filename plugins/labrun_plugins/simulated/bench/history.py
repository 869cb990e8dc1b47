"""The memory of a bench, to the last bit: its signals on its own time grid, what joints and carriage were told."""

import base64
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray, Trajectory
from labrun.errors import ExperimentError
from labrun.models import kernel

IntArray = NDArray[np.int64]


class History:
    """Signals on a uniform time grid; the latest stretch of them is kept.

    Parameters
    ----------
    step_s
        Grid step.
    signals
        Number of columns.
    keep_s
        At least this much stays.
    """

    def __init__(self, step_s: float, signals: int, keep_s: float = 120.0) -> None:
        self.step_s = step_s
        self._keep = max(2, round(keep_s / step_s))
        self._rows = np.empty((1024, signals))
        self._count = 0
        self._first = 0

    @property
    def end(self) -> int:
        """Number of the grid point after the last one known."""
        return self._first + self._count

    @property
    def newest(self) -> FloatArray:
        """Signals at the grid point known last, shape (signals,)."""
        return np.array(self._rows[self._count - 1])

    def append(self, rows: FloatArray) -> None:
        """Add the next grid points, shape (n, signals)."""
        need = self._count + len(rows)
        if need > len(self._rows):
            if self._count > 2 * self._keep:
                kept = self._rows[self._count - self._keep : self._count].copy()
                self._first += self._count - self._keep
                self._count = self._keep
                need = self._count + len(rows)
                self._rows[: self._count] = kept
            if need > len(self._rows):
                larger = np.empty((2 * need, self._rows.shape[1]))
                larger[: self._count] = self._rows[: self._count]
                self._rows = larger
        self._rows[self._count : need] = rows
        self._count = need

    def at(self, columns: IntArray, time_s: FloatArray) -> FloatArray:
        """Return the signals at these times, linear between grid points, shape (n, columns).

        Raises ExperimentError: a time that is no longer, or not yet, known.
        """
        values = np.empty((len(time_s), len(columns)))
        known_rows = self._rows[: self._count]
        if not _interpolate(
            known_rows, self._first, self.step_s, columns, np.ascontiguousarray(time_s), values
        ):
            known = f"{self._first * self.step_s:.3f} ... {(self.end - 1) * self.step_s:.3f} s"
            raise ExperimentError(
                f"the simulated bench was asked for {time_s.min():.3f} ... {time_s.max():.3f} s, it knows {known}",
                hint="sensors must be read at least every two minutes of a dry run",
            )
        return values

    def snapshot(self, span_s: float) -> list[Any]:
        """Return the last stretch as JSON-ready values."""
        rows = min(self._count, max(2, int(np.ceil(span_s / self.step_s))))
        return [self.end - rows, packed(self._rows[self._count - rows : self._count])]

    def restore(self, stored: list[Any]) -> None:
        """Take back what `snapshot` gave."""
        rows = unpacked(stored[1])
        self._first, self._count = int(stored[0]), 0
        self.append(rows)


def packed(array: FloatArray) -> dict[str, Any]:
    """Return an array of float64 as shape and base64 of its bytes."""
    data = np.ascontiguousarray(array, dtype="<f8")
    return {"shape": list(data.shape), "base64": base64.b64encode(data.tobytes()).decode("ascii")}


def unpacked(stored: dict[str, Any]) -> FloatArray:
    """Return what `packed` was given."""
    data = np.frombuffer(base64.b64decode(stored["base64"]), dtype="<f8")
    return data.reshape(stored["shape"]).astype(np.float64)


def sealed(memory: dict[str, Any]) -> dict[str, Any]:
    """Return a memory in a form that nobody reads by accident."""
    text = json.dumps(memory, separators=(",", ":"))
    return {"sealed": base64.b64encode(zlib.compress(text.encode())).decode("ascii")}


def unsealed(stored: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what `sealed` was given; a memory that is not sealed as it is."""
    if "sealed" not in stored:
        return stored
    memory: dict[str, Any] = json.loads(zlib.decompress(base64.b64decode(stored["sealed"])))
    return memory


def generator_state(rng: np.random.Generator) -> dict[str, Any]:
    """Return the state of a generator; its large integers stay integers, which JSON keeps exactly."""
    return dict(rng.bit_generator.state)


def restore_generator(rng: np.random.Generator, state: dict[str, Any]) -> None:
    """Take back what `generator_state` gave."""
    rng.bit_generator.state = state


@kernel
def _interpolate(
    rows: FloatArray, first: int, step_s: float, columns: IntArray, time_s: FloatArray, out: FloatArray
) -> bool:
    """Write the values between grid points; False where a time is not known."""
    for i in range(len(time_s)):
        # Absolute until the weight is known: what has been forgotten must not change the rounding.
        position = time_s[i] / step_s
        point = math.floor(position)
        weight = position - point
        index = int(point) - first
        if index < 0 or index + 1 >= len(rows):
            return False
        for j in range(len(columns)):
            below = rows[index, columns[j]]
            out[i, j] = below + weight * (rows[index + 1, columns[j]] - below)
    return True


ACCELERATION_M_S2 = 0.5
"""Ramp length v^2 / 2a: 1 cm at 0.1 m/s. The value is common for a linear move of a UR5 (chosen)."""
ROUNDING_S = 0.05
"""An arm's acceleration does not jump: it takes this long to rise and to fall (chosen)."""


@dataclass
class JointDrive:
    """The commands of one joint: each runs until the next one starts, and holds its last point.

    Attributes
    ----------
    rest_rad
        The angle before any command.
    """

    rest_rad: float = 0.0
    _moves: list[tuple[float, FloatArray, FloatArray]] = field(default_factory=list)

    def command(self, trajectory: Trajectory, start_s: float) -> None:
        """Add a command; it supersedes those that would start at the same time or later."""
        self._moves = [move for move in self._moves if move[0] < start_s]
        self._moves.append((start_s, trajectory.time_s, trajectory.angle_rad[:, 0]))

    def angles(self, time_s: FloatArray) -> FloatArray:
        """Return the commanded angles at ascending times, shape (n,)."""
        angle = np.empty(len(time_s))
        self.write(time_s, angle)
        return angle

    def write(self, time_s: FloatArray, angle_rad: FloatArray) -> None:
        """Write the commanded angles at ascending times, shape (n,)."""
        if self._moves and len(time_s):
            start_s, times, points = self._moves[-1]
            if time_s[0] >= start_s + times[-1]:  # at rest, as nearly always
                angle_rad.fill(points[-1])
                return
        angle_rad.fill(self.rest_rad)
        for start_s, times, points in self._moves:
            first = int(time_s.searchsorted(start_s))
            if first < len(time_s):
                angle_rad[first:] = np.interp(time_s[first:] - start_s, times, points)

    def under_way(self, time_s: FloatArray) -> FloatArray:
        """Tell whether a command is under way (1) or has ended (0), at ascending times, shape (n,)."""
        active = np.zeros(len(time_s))
        for start_s, times, _ in self._moves:
            first = int(np.searchsorted(time_s, start_s))
            active[first:] = time_s[first:] <= start_s + times[-1]
        return active

    def forget_before(self, time_s: float) -> None:
        """Drop commands that no longer matter from `time_s` on."""
        started = [index for index, move in enumerate(self._moves) if move[0] <= time_s]
        if not started:
            return
        self._moves = self._moves[started[-1] :]
        start_s, times, points = self._moves[0]
        if start_s + times[-1] < time_s and len(times) > 1:
            # Ended: its last point is all that is left of it. The time is kept, so that "ended" stays true.
            self._moves[0] = (start_s + times[-1], np.zeros(1), points[-1:].copy())
            return
        # Under way: the points already passed but the last are of no more use, and would only swell the snapshot.
        passed = int(np.searchsorted(times, time_s - start_s)) - 2
        if passed > 0:
            self._moves[0] = (start_s, times[passed:], points[passed:])

    def snapshot(self) -> list[Any]:
        """Return the commands as JSON-ready values."""
        return [
            self.rest_rad,
            [[start_s, packed(times), packed(points)] for start_s, times, points in self._moves],
        ]

    def restore(self, stored: list[Any]) -> None:
        """Take back what `snapshot` gave."""
        self.rest_rad = float(stored[0])
        self._moves = [
            (float(start_s), unpacked(times), unpacked(points)) for start_s, times, points in stored[1]
        ]


@dataclass
class Carriage:
    """Where the carriage is, over time: the last move, and where it came from."""

    _from_m: float = 0.0
    _to_m: float = 0.0
    _speed_m_s: float = 0.0
    _start_s: float = 0.0
    _acceleration_m_s2: float = ACCELERATION_M_S2
    _later: list[list[float]] = field(default_factory=list)

    @property
    def at_rest(self) -> bool:
        """Tell whether it stands still, and no move is to come."""
        return not self._later and (self._to_m == self._from_m or self._speed_m_s <= 0.0)

    @property
    def position_m(self) -> float:
        """Where the last move ends."""
        return self._to_m

    def move(
        self,
        from_m: float,
        to_m: float,
        speed_m_s: float,
        start_s: float,
        acceleration_m_s2: float = ACCELERATION_M_S2,
    ) -> None:
        """Take a move from `start_s` on; it supersedes those that would start later."""
        self._later = [move for move in self._later if move[3] < start_s]
        self._later.append([from_m, to_m, speed_m_s, start_s, acceleration_m_s2])

    def motion(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position (m), speed (m/s), acceleration (m/s^2) at ascending times; forgets moves that are over."""
        if not self._later:
            position, speed, acceleration = self._current(time_s)
            return position, speed, acceleration
        parts = []
        first = 0
        while self._later:
            last = int(np.searchsorted(time_s, self._later[0][3]))
            if last >= len(time_s):
                break
            parts.append(self._current(time_s[first:last]))
            self._begin(self._later.pop(0))
            first = last
        parts.append(self._current(time_s[first:]))
        position, speed, acceleration = np.concatenate(parts, axis=1)
        return position, speed, acceleration

    def _begin(self, move: list[float]) -> None:
        self._from_m, self._to_m, self._speed_m_s, self._start_s, self._acceleration_m_s2 = move

    def _current(self, time_s: FloatArray) -> FloatArray:
        """Return position, speed, acceleration of the current move, shape (3, n): a trapezoid of speed, rounded.

        Rounded by the mean over the last `ROUNDING_S`, so that the acceleration goes straight up and down.
        """
        if self._to_m == self._from_m or self._speed_m_s <= 0.0:
            still = np.zeros((3, len(time_s)))
            still[0] = self._to_m
            return still
        since_s = time_s - self._start_s
        moved = (self._sharp(since_s) - self._sharp(since_s - ROUNDING_S)) / ROUNDING_S
        moved *= math.copysign(1.0, self._to_m - self._from_m)
        moved[0] += self._from_m
        return moved

    def _sharp(self, since_s: FloatArray) -> FloatArray:
        """Return the integral of the way, the way, and the speed of a trapezoid of speed, shape (3, n)."""
        way, ramp = abs(self._to_m - self._from_m), self._acceleration_m_s2
        top = min(self._speed_m_s, math.sqrt(ramp * way))
        ramp_s = top / ramp
        end_s = way / top + ramp_s
        t = np.clip(since_s, 0.0, end_s)
        up, down = np.minimum(t, ramp_s), np.maximum(0.0, t - (end_s - ramp_s))
        even = t - up
        gone = ramp * (0.5 * up**2 + ramp_s * even - 0.5 * down**2)
        summed = ramp * (up**3 / 6.0 + 0.5 * ramp_s * even * (ramp_s + even) - down**3 / 6.0)
        return np.stack([summed + way * np.maximum(since_s - end_s, 0.0), gone, ramp * (up - down)])

    def snapshot(self) -> list[object]:
        """Return the moves as JSON-ready values."""
        return [
            self._from_m,
            self._to_m,
            self._speed_m_s,
            self._start_s,
            self._acceleration_m_s2,
            [list(move) for move in self._later],
        ]

    def restore(self, stored: list[object]) -> None:
        """Take back what `snapshot` gave."""
        self._begin([float(str(value)) for value in stored[:5]])
        later = stored[5]
        self._later = [[float(value) for value in move] for move in later] if isinstance(later, list) else []
