"""When the bench has come to rest: the rule of the file, applied to windows of the signal as it comes in."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from labrun.devices import FloatArray, Samples
from labrun.runner.stillness import Stillness, stillness

_STEPS = 10
"""Judgements per hold time."""
_BASELINE_QUANTILE = 0.95
_HISTORY = 2.0
"""Hold times looked back on at once before the bench counts as at rest."""


@dataclass(frozen=True, slots=True)
class Watched:
    """One channel that settling looks at."""

    device: str
    column: int
    name: str
    """``device.channel``."""
    unit: str


@dataclass(frozen=True, slots=True)
class Bounds:
    """What spread and drift must stay below, one a watched channel, in its unit."""

    spread: tuple[float, ...]
    drift: tuple[float, ...]


class Window:
    """The last `length_s` of some channels of one device, and as much again before it."""

    def __init__(self, columns: list[int], length_s: float) -> None:
        self._columns = columns
        self._length_s = length_s
        self._times: deque[FloatArray] = deque()
        self._values: deque[FloatArray] = deque()
        self._first_s = np.inf

    def add(self, block: Samples) -> None:
        """Take new samples, and drop what is older than the window."""
        if len(block) == 0:
            return
        self._times.append(block.host_time_s)
        self._values.append(block.values[:, self._columns])
        self._first_s = min(self._first_s, float(block.host_time_s[0]))
        begin_s = block.host_time_s[-1] - _HISTORY * self._length_s
        while len(self._times) > 1 and self._times[0][-1] < begin_s:
            self._times.popleft()
            self._values.popleft()

    def judge(self, now_s: float, lengths: float = 1.0) -> Stillness | None:
        """Return how still the last `lengths` windows are, taken as one; None while they are not full."""
        length_s = lengths * self._length_s
        if not self._times or now_s - self._first_s < length_s * (1 - 1e-9):
            return None
        times = np.concatenate(self._times)
        begin = int(np.searchsorted(times, times[-1] - length_s))
        return stillness(times[begin:], np.concatenate(self._values)[begin:])


class Judge:
    """Judges all watched channels together, a few times per hold time."""

    def __init__(self, watched: tuple[Watched, ...], hold_s: float) -> None:
        self._step_s = hold_s / _STEPS
        self._due_s = -np.inf
        self._order: list[int] = []
        self._windows: dict[str, Window] = {}
        for device in dict.fromkeys(w.device for w in watched):
            positions = [i for i, w in enumerate(watched) if w.device == device]
            self._order += positions
            self._windows[device] = Window([watched[i].column for i in positions], hold_s)

    def judge(self, blocks: Mapping[str, Samples], now_s: float) -> Stillness | None:
        """Take new samples; return spread, drift and resolution in the order of `watched`, if it is time to."""
        for device, window in self._windows.items():
            window.add(blocks[device])
        if now_s < self._due_s:
            return None
        found = self.look_back(now_s, 1.0)
        if found is not None:
            self._due_s = now_s + self._step_s * (1 - 1e-9)
        return found

    def look_back(self, now_s: float, lengths: float) -> Stillness | None:
        """Judge the last `lengths` hold times as one window; None while they are not full."""
        parts = [window.judge(now_s, lengths) for window in self._windows.values()]
        found = [part for part in parts if part is not None]
        if len(found) < len(parts):
            return None
        if len(found) == 1:  # one device: in order already
            return found[0]
        back = np.argsort(self._order)
        return Stillness(
            np.concatenate([part.spread for part in found])[back],
            np.concatenate([part.drift for part in found])[back],
            np.concatenate([part.resolution for part in found])[back],
        )


@dataclass
class SettleDetector:
    """Tells when the watched channels have been still for `hold_s`.

    Every judgement looks at the last `hold_s`; the bench is at rest when all judgements over a further `hold_s` find
    spread and drift below their bounds, and so does one look at both hold times together. The hold unmasks a slow
    wave at its crest, where it neither spreads nor drifts for a moment; the longer look unmasks one that noise hides
    from each window.

    Attributes
    ----------
    time_s, spread, drift
        The curve so far: for each judgement the channel that is farthest from rest.
    channel
        That channel at the last judgement.
    """

    watched: tuple[Watched, ...]
    bounds: Bounds
    hold_s: float
    start_s: float
    time_s: list[float] = field(default_factory=list)
    spread: list[float] = field(default_factory=list)
    drift: list[float] = field(default_factory=list)
    worst: int = 0
    settled: bool = False

    def __post_init__(self) -> None:
        self._judge = Judge(self.watched, self.hold_s)
        self._spread_bound = np.array(self.bounds.spread)
        self._drift_bound = np.array(self.bounds.drift)
        self._quiet_since_s: float | None = None

    def feed(self, blocks: Mapping[str, Samples], now_s: float) -> bool:
        """Take new samples; return whether the bench has come to rest."""
        found = self._judge.judge(blocks, now_s)
        if found is None:
            return self.settled
        share = np.maximum(found.spread / self._spread_bound, found.drift / self._drift_bound)
        self.worst = int(np.argmax(share))
        self.time_s.append(now_s - self.start_s)
        self.spread.append(float(found.spread[self.worst]))
        self.drift.append(float(found.drift[self.worst]))
        if share[self.worst] > 1.0:
            self._quiet_since_s = None
        elif self._quiet_since_s is None:
            self._quiet_since_s = now_s
        since_s = self._quiet_since_s
        held = since_s is not None and now_s - since_s >= self.hold_s * (1 - 1e-9)
        self.settled = held and self._still_over_all(now_s)
        return self.settled

    def _still_over_all(self, now_s: float) -> bool:
        found = self._judge.look_back(now_s, _HISTORY)
        if found is None:
            return False
        # Drift is counted per hold time, whatever the window it was found in.
        quiet = (found.spread <= self._spread_bound) & (found.drift / _HISTORY <= self._drift_bound)
        return bool(np.all(quiet))


class BaselineMeter:
    """Finds how still the undisturbed bench is: what "quiet" means where the file gives no number."""

    def __init__(self, watched: tuple[Watched, ...], hold_s: float) -> None:
        self._judge = Judge(watched, hold_s)
        self._found: list[Stillness] = []

    def feed(self, blocks: Mapping[str, Samples], now_s: float) -> None:
        """Take new samples."""
        found = self._judge.judge(blocks, now_s)
        if found is not None:
            self._found.append(found)

    def bounds(self) -> Bounds | None:
        """Return the baseline; None if no window was full.

        Per channel, the 95th percentile over the windows, but never less than the noise lets one see.
        """
        if not self._found:
            return None
        floor = np.median([f.resolution for f in self._found], axis=0)
        floor = np.maximum(floor, np.finfo(float).tiny)
        spread = np.quantile([f.spread for f in self._found], _BASELINE_QUANTILE, axis=0)
        drift = np.quantile([f.drift for f in self._found], _BASELINE_QUANTILE, axis=0)
        return Bounds(
            tuple(map(float, np.maximum(spread, floor))), tuple(map(float, np.maximum(drift, floor)))
        )
