"""Before a recording: wait until the bench is at rest, then find the zero of its force channels."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from labrun.devices import FloatArray, Samples
from labrun.errors import DeviceError, ExperimentError, SettleError, SpecError
from labrun.runner.bench import Bench
from labrun.runner.rig import Rig
from labrun.signals import Signals
from labrun.spec import Settle, Tare
from labrun.store import SettleSummary, TrialOutcome, settle_curve

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
    """Tell how much of a window is motion, beyond its noise.

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
        self._monitor = StillnessMonitor(self.watched, self.hold_s)
        self._spread_bound = np.array(self.bounds.spread)
        self._drift_bound = np.array(self.bounds.drift)
        self._quiet_since_s: float | None = None

    def feed(self, blocks: Mapping[str, Samples], now_s: float) -> bool:
        """Take new samples; return whether the bench has come to rest."""
        found = self._monitor.update(blocks, now_s)
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
        found = self._monitor.look_back(now_s, _HISTORY)
        if found is None:
            return False
        # Drift is counted per hold time, whatever the window it was found in.
        quiet = (found.spread <= self._spread_bound) & (found.drift / _HISTORY <= self._drift_bound)
        return bool(np.all(quiet))


class BaselineMeter:
    """Finds how still the undisturbed bench is: what "quiet" means where the file gives no number."""

    def __init__(self, watched: tuple[Watched, ...], hold_s: float) -> None:
        self._monitor = StillnessMonitor(watched, hold_s)
        self._found: list[Stillness] = []

    def feed(self, blocks: Mapping[str, Samples], now_s: float) -> None:
        """Take new samples."""
        found = self._monitor.update(blocks, now_s)
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


_BASELINE_HOLDS = 6.0
_BASELINE_S = 10.0
_LOOKS_PER_HOLD = 2.0
"""At least so often, however coarse the clock: the end of settling is not to wait for the next look."""


@dataclass(frozen=True, slots=True)
class Settled:
    """How settling ended.

    Attributes
    ----------
    summary, curve
        What is stored with the trial; the curve is None where nothing was watched.
    rejected
        Why the trial must not go on; empty if it may.
    """

    summary: SettleSummary | None
    curve: Signals | None
    rejected: str = ""


def watched_channels(rule: Settle, rig: Rig) -> tuple[Watched, ...]:
    """Return the channels a settle rule looks at: the one it names, else every force, else every torque, else all."""
    known = [
        Watched(name, column, f"{name}.{channel.name}", channel.unit)
        for name, sensor in rig.sensors.items()
        for column, channel in enumerate(sensor.channels)
    ]
    if rule.channel is not None:
        chosen = tuple(item for item in known if item.name == rule.channel)
        if not chosen:
            names = ", ".join(item.name for item in known) or "none: the rig has no sensor"
            raise SpecError(
                f"trial.settle.channel: there is no channel {rule.channel!r}", hint=f"channels: {names}"
            )
        return chosen
    if not known:
        raise SpecError(
            "trial.settle needs a sensor to watch, and the rig has none", hint='use until = "time"'
        )
    for unit in ("N", "N m"):
        chosen = tuple(item for item in known if item.unit == unit)
        if chosen:
            return chosen
    return tuple(known)


def needs_baseline(rule: Settle | None) -> bool:
    """Tell whether the rule compares with the bench's own quiet baseline."""
    return rule is not None and rule.until == "quiet" and rule.below is None


def measure_baseline(bench: Bench, rule: Settle) -> Bounds:
    """Measure how still the undisturbed bench is. Raises ExperimentError: too few samples came in to judge."""
    watched = watched_channels(rule, bench.rig)
    meter = BaselineMeter(watched, rule.hold_s)
    bench.start_sensors()
    duration_s = max(_BASELINE_S, _BASELINE_HOLDS * rule.hold_s)
    bench.watch(bench.clock.now() + duration_s, lambda blocks: meter.feed(blocks, bench.clock.now()))
    bench.stop_sensors()
    bounds = meter.bounds()
    if bounds is None:
        raise ExperimentError(_too_few(watched, rule), hint="raise trial.settle.hold_s")
    return bounds


def settle(bench: Bench, rule: Settle | None, baseline: Bounds | None) -> Settled:
    """Wait until the bench is at rest; sensors must be running, and are under watch meanwhile.

    Raises SettleError: not at rest in time, and the file says ``on_timeout = "stop"``.
    """
    if rule is None:
        return Settled(None, None)
    start_s = bench.clock.now()
    if rule.until == "time":
        bench.watch(start_s + rule.hold_s)
        return Settled(SettleSummary("time", bench.clock.now() - start_s), None)
    watched = watched_channels(rule, bench.rig)
    bounds = _bounds(rule, baseline, len(watched))
    detector = SettleDetector(watched, bounds, rule.hold_s, start_s)
    deadline_s = start_s + rule.timeout_s
    while not detector.settled and bench.clock.now() < deadline_s:
        _look(bench, detector, deadline_s)
    reason = "quiet" if detector.settled else "timeout"
    return _ended(rule, detector, bounds, reason, bench.clock.now() - start_s)


def _look(bench: Bench, detector: SettleDetector, deadline_s: float) -> None:
    # Before the first hold time has passed there is nothing to judge; after it, looks are finer than a coarse clock's.
    first_s = detector.start_s + detector.hold_s - bench.clock.now()
    step_s = min(bench.clock.poll_s, max(first_s, detector.hold_s / _LOOKS_PER_HOLD))
    bench.clock.sleep(min(step_s, deadline_s - bench.clock.now()))
    blocks: Mapping[str, Samples] = bench.look()
    detector.feed(blocks, bench.clock.now())


def _bounds(rule: Settle, baseline: Bounds | None, channels: int) -> Bounds:
    if rule.below is not None:
        return Bounds((rule.below,) * channels, (rule.below,) * channels)
    if baseline is None:
        raise ExperimentError("the quiet baseline of the bench was not measured before the first trial")
    return Bounds(
        tuple(rule.factor * value for value in baseline.spread),
        tuple(rule.factor * value for value in baseline.drift),
    )


def _ended(rule: Settle, detector: SettleDetector, bounds: Bounds, reason: str, duration_s: float) -> Settled:
    channel = detector.watched[detector.worst]
    bound = bounds.spread[detector.worst]
    spread = detector.spread[-1] if detector.spread else None
    drift = detector.drift[-1] if detector.drift else None
    summary = SettleSummary(reason, duration_s, spread, drift, bound, channel.name)
    curve = settle_curve(
        np.array(detector.time_s), np.array(detector.spread), np.array(detector.drift), channel.unit
    )
    if reason == "quiet" or rule.on_timeout == "go-on":
        return Settled(summary, curve)
    if spread is None or drift is None:
        text = _too_few(detector.watched, rule)
    else:
        text = (
            f"not at rest after {duration_s:.0f} s: {channel.name} spreads by {spread:.3g} and drifts by {drift:.3g} "
            f"{channel.unit} in {rule.hold_s:g} s, {bound:.3g} {channel.unit} is allowed"
        )
    if rule.on_timeout == "stop":
        raise SettleError(
            text, hint="look for what disturbs the bench, or raise trial.settle.timeout_s or below"
        )
    return Settled(summary, curve, rejected=text)


def _too_few(watched: tuple[Watched, ...], rule: Settle) -> str:
    names = ", ".join(item.name for item in watched)
    return f"{names} gave too few samples in {rule.hold_s:g} s to tell motion from noise"


def unsettled(outcome: TrialOutcome) -> bool:
    """Tell whether a trial counts although the bench had not come to rest before it."""
    return outcome.status == "done" and outcome.settle is not None and outcome.settle.reason == "timeout"


def settle_estimate_s(rule: Settle | None) -> float:
    """Return the settle time a plan counts with: two hold times, the least that evidence takes; never above the cap."""
    if rule is None:
        return 0.0
    if rule.until == "time":
        return rule.hold_s
    return min(2.0 * rule.hold_s, rule.timeout_s)


_FORCE_UNITS = ("N", "N m")


def tared_devices(rule: Tare | None, rig: Rig) -> tuple[str, ...]:
    """Return the devices that are tared: those the rule names, else every sensor of forces or torques."""
    if rule is None:
        return ()
    if rule.devices is None:
        return tuple(n for n, s in rig.sensors.items() if any(c.unit in _FORCE_UNITS for c in s.channels))
    for name in rule.devices:
        if name not in rig.sensors:
            known = ", ".join(rig.sensors) or "none"
            raise SpecError(
                f"trial.tare.devices: {name!r} is not a sensor of this rig", hint=f"sensors: {known}"
            )
    return tuple(rule.devices)


def tare(bench: Bench, rule: Tare | None) -> dict[str, float]:
    """Average the force and torque channels while nothing moves.

    Returns
    -------
    dict
        ``"device.channel"`` -> offset in the channel's unit. Raw data stay raw: this is subtracted in analysis.

    Raises
    ------
    DeviceError
        A device gave no sample in the time the rule allows.
    """
    if rule is None:
        return {}
    names = tared_devices(rule, bench.rig)
    collected: dict[str, list[FloatArray]] = {name: [] for name in names}

    def collect(blocks: Mapping[str, Samples]) -> None:
        for name, parts in collected.items():
            if len(blocks[name]):
                parts.append(blocks[name].values)

    bench.watch(bench.clock.now() + rule.duration_s, collect)
    offsets: dict[str, float] = {}
    for name, parts in collected.items():
        if not parts:
            raise DeviceError(name, f"gave no sample in the {rule.duration_s:g} s of trial.tare.duration_s")
        mean = np.concatenate(parts).mean(axis=0)
        for channel, value in zip(bench.rig.sensors[name].channels, mean, strict=True):
            if channel.unit in _FORCE_UNITS:
                offsets[f"{name}.{channel.name}"] = float(value)
    return offsets
