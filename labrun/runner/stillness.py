"""Judge whether channels are quiet: spread and drift of the last samples against bounds or a baseline."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from labrun.devices import FloatArray, Samples

_BINS = 20
_LEAST_PER_BIN = 3
_CLIP = 5.0
_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, slots=True)
class Stillness:
    """Motion of several channels within one window, in their units.

    Attributes
    ----------
    spread : (channels,)
        Standard deviation of the slow part of the signal, beyond what noise explains.
    drift : (channels,)
        Change over the window by its slope, beyond twice its standard error.
    resolution : (channels,)
        The smallest spread or drift that stands out from the noise.
    """

    spread: FloatArray
    drift: FloatArray
    resolution: FloatArray


def stillness(time_s: FloatArray, values: FloatArray) -> Stillness | None:
    """Return spread and drift of a window beyond its noise.

    Samples are averaged in up to 20 bins. The variance between bins, less what the noise within them explains, is that
    of the slow part (one-way random-effects analysis of variance; Searle, Casella, McCulloch, "Variance components",
    1992, sec. 3.6). Noise is taken from successive differences (von Neumann 1941), which a slow motion hardly enters.
    Two standard errors of the estimate are taken off as well, so that white sensor noise alone, however strong, does
    not count as motion, while a wall echo of 0.1 to 1 Hz well below the noise of a single sample does. Single wild
    samples are clipped at five robust standard deviations from their bin's median. Drift is the slope of the bins'
    means times the window, less two of its standard errors.

    Parameters
    ----------
    time_s : (n,)
        Times of the samples, ascending.
    values : (n, channels)
        The signals.

    Returns
    -------
    Stillness or None
        None with too few samples to tell noise from motion (fewer than 12).
    """
    count = len(values)
    bins = min(_BINS, count // _LEAST_PER_BIN)
    if bins < 4:
        return None
    each = count // bins
    start = count - bins * each
    # One row a bin, so that every operation runs along memory.
    grouped = np.ascontiguousarray(values[start:].T).reshape(-1, bins, each)
    centre = _median(grouped)
    rest = grouped - centre
    scale = _SIGMA * _median(np.abs(rest).reshape(-1, 1, bins * each))
    ceiling = _CLIP * scale
    ceiling[ceiling <= 0.0] = np.inf
    rest = np.minimum(np.maximum(rest, -ceiling), ceiling)
    means = centre[:, :, 0] + np.add.reduce(rest, axis=2) / each
    steps = rest[:, :, 1:] - rest[:, :, :-1]
    within = np.add.reduce(steps * steps, axis=(1, 2)) / (bins * (each - 1) * 2.0 * each)
    apart = means - (np.add.reduce(means, axis=1) / bins)[:, None]
    between = np.add.reduce(apart * apart, axis=1) / (bins - 1)
    uncertainty = within * math.sqrt(2.0 / (bins - 1))
    spread = np.sqrt(np.maximum(0.0, between - within - 2.0 * uncertainty))
    times = np.add.reduce(time_s[start:].reshape(bins, each), axis=1) / each
    centred = times - np.add.reduce(times) / bins
    length_s = float(time_s[-1] - time_s[0])
    moment = float(centred @ centred)
    slope = apart @ centred / moment
    error = np.sqrt(within / moment)
    drift = np.maximum(0.0, np.abs(slope) - 2.0 * error) * length_s
    return Stillness(spread, drift, np.maximum(np.sqrt(uncertainty), error * length_s))


def _median(values: FloatArray) -> FloatArray:
    """Return the median over the last axis, kept; `numpy.median` checks more, and is slow on small arrays."""
    middle = values.shape[2] // 2
    if values.shape[2] % 2:
        return np.partition(values, middle, axis=2)[:, :, middle : middle + 1]
    lower = np.partition(values, (middle - 1, middle), axis=2)
    return np.asarray(0.5 * (lower[:, :, middle - 1 : middle] + lower[:, :, middle : middle + 1]))


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
        """Append new samples, and drop those older than the window."""
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


class StillnessMonitor:
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

    def update(self, blocks: Mapping[str, Samples], now_s: float) -> Stillness | None:
        """Take new samples; return spread, drift and resolution in the order of `watched`, if it is time to."""
        for device, window in self._windows.items():
            window.add(blocks[device])
        if now_s < self._due_s:
            return None
        back = self.look_back(now_s, 1.0)
        if back is not None:
            self._due_s = now_s + self._step_s * (1 - 1e-9)
        return back

    def look_back(self, now_s: float, lengths: float) -> Stillness | None:
        """Judge the last `lengths` hold times as one window; None while they are not full."""
        parts = [window.judge(now_s, lengths) for window in self._windows.values()]
        known_parts = [part for part in parts if part is not None]
        if len(known_parts) < len(parts):
            return None
        if len(known_parts) == 1:  # one device: in order already
            return known_parts[0]
        back = np.argsort(self._order)
        return Stillness(
            np.concatenate([part.spread for part in known_parts])[back],
            np.concatenate([part.drift for part in known_parts])[back],
            np.concatenate([part.resolution for part in known_parts])[back],
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
        self._monitor = StillnessMonitor(self.watched, self.hold_s)
        self._spread_bound = np.array(self.bounds.spread)
        self._drift_bound = np.array(self.bounds.drift)
        self._quiet_since_s: float | None = None

    def feed(self, blocks: Mapping[str, Samples], now_s: float) -> bool:
        """Take new samples; return whether the bench has come to rest."""
        update = self._monitor.update(blocks, now_s)
        if update is None:
            return self.settled
        share = np.maximum(update.spread / self._spread_bound, update.drift / self._drift_bound)
        self.worst = int(np.argmax(share))
        self.time_s.append(now_s - self.start_s)
        self.spread.append(float(update.spread[self.worst]))
        self.drift.append(float(update.drift[self.worst]))
        if share[self.worst] > 1.0:
            self._quiet_since_s = None
        elif self._quiet_since_s is None:
            self._quiet_since_s = now_s
        since_s = self._quiet_since_s
        held = since_s is not None and now_s - since_s >= self.hold_s * (1 - 1e-9)
        self.settled = held and self._still_over_all(now_s)
        return self.settled

    def _still_over_all(self, now_s: float) -> bool:
        back = self._monitor.look_back(now_s, _HISTORY)
        if back is None:
            return False
        # Drift is counted per hold time, whatever the window it was found in.
        quiet = (back.spread <= self._spread_bound) & (back.drift / _HISTORY <= self._drift_bound)
        return bool(np.all(quiet))


class BaselineMeter:
    """Finds how still the undisturbed bench is: what "quiet" means where the file gives no number."""

    def __init__(self, watched: tuple[Watched, ...], hold_s: float) -> None:
        self._monitor = StillnessMonitor(watched, hold_s)
        self._found: list[Stillness] = []

    def feed(self, blocks: Mapping[str, Samples], now_s: float) -> None:
        """Take new samples."""
        update = self._monitor.update(blocks, now_s)
        if update is not None:
            self._found.append(update)

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
