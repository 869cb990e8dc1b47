"""Signals over time with their units and tare: the one form of measured data from the runner to the report."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RecordingError

TIMES = ("time_s", "device_time_s", "host_time_s")
"""Time axes: from the start of the trial; by the device's own clock; of receipt, by this machine's clock."""
MEMORY_ROWS = 1 << 17
"""Samples of a long recording that are in memory at a time: 1 MiB a column."""


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal over time.

    Attributes
    ----------
    time_s : (n,)
        From the start of the trial, ascending.
    values : (n,)
        In `unit`.
    unit
        SI unit of the values.
    """

    time_s: FloatArray
    values: FloatArray
    unit: str

    def between(self, start_s: float, end_s: float) -> "Signal":
        """Return the samples from `start_s` to `end_s`, both included."""
        first, end = np.searchsorted(self.time_s, start_s), np.searchsorted(self.time_s, end_s, side="right")
        return Signal(self.time_s[first:end], self.values[first:end], self.unit)

    def known(self) -> "Signal":
        """Return the samples that are finite numbers."""
        finite = np.isfinite(self.values)
        return Signal(self.time_s[finite], self.values[finite], self.unit)

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return values at other times, straight between the finite samples; beyond them the first or the last."""
        known = self.known()
        return np.asarray(np.interp(time_s, known.time_s, known.values))


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """Signals of one trial: of a device, of the command, or of settling.

    Attributes
    ----------
    name
        The device's name in the experiment file; ``"command"``, ``"settle"``.
    columns, units
        Names of the signals, and the unit of each.
    time_s : (n,)
        From the start of the trial, strictly increasing.
    values : (n, columns)
        In `units`, as measured.
    tare
        Offset found just before the recording, by column, in its unit; `tared` takes it off.
    device_time_s, host_time_s : (n,)
        Both times of every sample as they came, never altered; None where there is one time only.
    rate_hz
        Nominal sample rate; NaN where there is none.
    lost, saturated
        Number of samples that never arrived, and that stood at the end of the measuring range.
    clock_glitches
        Places where the device's time jumped, stood still or ran backwards.
    """

    name: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    time_s: FloatArray
    values: FloatArray
    tare: Mapping[str, float] = field(default_factory=dict)
    device_time_s: FloatArray | None = None
    host_time_s: FloatArray | None = None
    rate_hz: float = np.nan
    lost: int = 0
    saturated: int = 0
    clock_glitches: int = 0

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, chosen: Any) -> "Signals":
        """Return the samples of a slice or a mask."""
        return replace(
            self,
            time_s=self.time_s[chosen],
            values=self.values[chosen],
            device_time_s=None if self.device_time_s is None else self.device_time_s[chosen],
            host_time_s=None if self.host_time_s is None else self.host_time_s[chosen],
        )

    def tared(self) -> "Signals":
        """Return the signals without their tare offsets."""
        if not self.tare:
            return self
        offsets = np.array([self.tare.get(column, 0.0) for column in self.columns])
        return replace(self, values=self.values - offsets, tare={})

    def column(self, name: str) -> FloatArray:
        """Return the values of one column, shape (n,); RecordingError if there is none of that name."""
        return self.values[:, self._place(name)]

    def unit(self, name: str) -> str:
        """Return the unit of one column; RecordingError if there is none of that name."""
        return self.units[self._place(name)]

    def signal(self, name: str) -> Signal:
        """Return one column over time; RecordingError if there is none of that name."""
        column = self._place(name)
        return Signal(self.time_s, self.values[:, column], self.units[column])

    def between(self, start_s: float, end_s: float) -> "Signals":
        """Return the samples from `start_s` to `end_s`, both included."""
        first, end = np.searchsorted(self.time_s, start_s), np.searchsorted(self.time_s, end_s, side="right")
        return self[first:end]

    def pieces(self) -> Iterator["Signals"]:
        """Yield all of it, as `LongSignals` does in parts."""
        yield self

    def pieces_from(self, first: int) -> Iterator["Signals"]:
        """Yield all from one sample on."""
        yield self[first:]

    def signal_pieces(self, name: str) -> Iterator[Signal]:
        """Yield one column, as `LongSignals` does in parts."""
        yield self.signal(name)

    def _place(self, name: str) -> int:
        try:
            return self.columns.index(name)
        except ValueError:
            known = ", ".join(self.columns) or "none"
            raise RecordingError(f"{self.name} has no signal {name!r}", hint=f"it has: {known}") from None


@dataclass(frozen=True, slots=True, eq=False)
class LongSignals:
    """Signals too long for memory: as `Signals`, but read in pieces on demand.

    Attributes
    ----------
    head
        The signals without samples.
    count
        Number of samples.
    make
        Yields consecutive pieces of at most `MEMORY_ROWS` samples, from the given one on.
    """

    head: Signals
    count: int
    make: Callable[[int], Iterator[Signals]]

    @property
    def name(self) -> str:
        """The device's name."""
        return self.head.name

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the signals."""
        return self.head.columns

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each signal."""
        return self.head.units

    def __len__(self) -> int:
        return self.count

    def tared(self) -> "LongSignals":
        """Return the signals without their tare offsets."""
        return LongSignals(
            self.head.tared(), self.count, lambda first: (piece.tared() for piece in self.make(first))
        )

    def pieces(self) -> Iterator[Signals]:
        """Yield consecutive pieces."""
        return self.make(0)

    def last(self, count: int) -> Signals:
        """Return the last so many samples, without reading the others."""
        return joined(self.make(max(self.count - count, 0)))

    def signal(self, name: str) -> Signal:
        """Return one column over time, in memory whole; RecordingError if there is none of that name."""
        parts = list(self.signal_pieces(name))
        time_s = np.concatenate([np.empty(0), *(part.time_s for part in parts)])
        values = np.concatenate([np.empty(0), *(part.values for part in parts)])
        return Signal(time_s, values, self.head.unit(name))

    def signal_pieces(self, name: str) -> Iterator[Signal]:
        """Yield one column in consecutive parts; RecordingError if there is none of that name."""
        self.head.unit(name)
        for piece in self.make(0):
            part = piece.signal(name)
            yield Signal(part.time_s, part.values.copy(), part.unit)  # lets go of the other columns


def joined(pieces: Iterator[Signals]) -> Signals:
    """Return consecutive pieces as one."""
    parts = list(pieces)
    if len(parts) == 1:
        return parts[0]

    def whole(name: str) -> Any:
        arrays = [getattr(part, name) for part in parts]
        return None if arrays[0] is None else np.concatenate(arrays)

    return replace(parts[0], **{name: whole(name) for name in (*TIMES, "values")})
