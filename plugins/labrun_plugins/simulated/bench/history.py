"""The memory of a bench: its signals lately, on its own time grid; everything as JSON-ready values, to the last bit."""

import base64
import json
import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray
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

        Raises
        ------
        ExperimentError
            A time that is no longer, or not yet, known.
        """
        found = np.empty((len(time_s), len(columns)))
        known_rows = self._rows[: self._count]
        if not _interpolate(
            known_rows, self._first, self.step_s, columns, np.ascontiguousarray(time_s), found
        ):
            known = f"{self._first * self.step_s:.3f} ... {(self.end - 1) * self.step_s:.3f} s"
            raise ExperimentError(
                f"the simulated bench was asked for {time_s.min():.3f} ... {time_s.max():.3f} s, it knows {known}",
                hint="sensors must be read at least every two minutes of a dry run",
            )
        return found

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
    rows: FloatArray, first: int, step_s: float, columns: IntArray, time_s: FloatArray, found: FloatArray
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
            found[i, j] = below + weight * (rows[index + 1, columns[j]] - below)
    return True
