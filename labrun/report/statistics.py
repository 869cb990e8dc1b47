"""What a run's trials say of the bench: repeatability, drift, settling, streams."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.report.data import Point, RunView
from labrun.search.leaders import pooled_variance
from labrun.signals import Signals
from labrun.store import JUMP_S, StreamReport, TrialOutcome, stream_report

FloatArray = NDArray[np.float64]

LEAST_JITTER_S = 1e-8
"""Below this, jitter is the rounding of the stored times."""


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Spread of an objective within a condition, beside its spread between conditions.

    Attributes
    ----------
    sd
        Standard deviation of single trials of one condition, pooled over all conditions that were repeated.
    degrees_of_freedom
        Behind `sd`.
    between_sd
        Standard deviation of the conditions' means; None for a single condition.
    """

    objective: str
    unit: str
    sd: float
    degrees_of_freedom: int
    between_sd: float | None


@dataclass(frozen=True, slots=True)
class Drift:
    """Slope of an objective over the run, by its reference trials, with its 95 % interval, per hour of bench time."""

    objective: str
    unit: str
    slope_per_h: float
    ci95: tuple[float, float]
    trials: int

    @property
    def visible(self) -> bool:
        """Whether the interval excludes zero."""
        return not self.ci95[0] <= 0.0 <= self.ci95[1]


@dataclass(frozen=True, slots=True)
class Settling:
    """How the bench came to rest: how often for which reason, and how long it took."""

    reasons: dict[str, int]
    median_s: float
    longest_s: float


@dataclass(frozen=True, slots=True)
class StreamHealth:
    """One device's stream, over the trials that were looked at.

    Attributes
    ----------
    nominal_hz, actual_hz
        Rate it should have, and median rate at which it sampled, samples that were lost on the way included.
    jitter_s
        Standard deviation of the time between samples, by the device's clock, gaps of lost samples left out; median
        over trials.
    lost, saturated
        Samples that never arrived, and that stood at the end of the range.
    lost_share
        Of all samples the device made.
    clock_offset_s
        Run clock minus device clock, median over trials; None without samples. Sample times have it in them already.
    clock_drift_ppm
        How fast the offset changes, parts per million, over the run, or within trials where the device's clock began
        anew between them; None where that is too short to tell.
    glitches
        Places where the device's time jumped, stood still or ran backwards.
    """

    device: str
    nominal_hz: float
    actual_hz: float
    jitter_s: float
    samples: int
    lost: int
    lost_share: float
    saturated: int
    clock_offset_s: float | None
    clock_drift_ppm: float | None
    glitches: int


def repeatability(view: RunView) -> list[Repeatability]:
    """Return the repeatability of every objective that was measured more than once at some condition."""
    found = []
    for name in view.experiment.objectives:
        points = view.points(name)
        variance = pooled_variance([point.values for point in points])
        if variance is None:
            continue
        freedom = sum(len(point.values) - 1 for point in points)
        found.append(Repeatability(name, view.unit_of(name), math.sqrt(variance), freedom, _between(points)))
    return found


def drift(view: RunView) -> list[Drift]:
    """Return the drift of every objective by least squares over at least three reference trials."""
    from scipy.stats import t

    found = []
    references = [o for o in view.run.outcomes if o.role == "reference" and o.status == "done"]
    for name in view.experiment.objectives:
        trials = [outcome for outcome in references if name in outcome.objectives]
        hours = np.array([outcome.started_s / 3600 for outcome in trials])
        values = np.array([outcome.objectives[name] for outcome in trials])
        if len(trials) < 3 or np.ptp(hours) == 0.0:
            continue
        centred = hours - hours.mean()
        slope = float(centred @ values / (centred @ centred))
        residual = values - values.mean() - slope * centred
        error = math.sqrt(float(residual @ residual) / (len(trials) - 2) / float(centred @ centred))
        half = float(t.ppf(0.975, len(trials) - 2)) * error
        found.append(Drift(name, view.unit_of(name), slope, (slope - half, slope + half), len(trials)))
    return found


def settling(outcomes: Iterable[TrialOutcome]) -> Settling | None:
    """Return how the bench came to rest before trials; None if the experiment does not wait."""
    summaries = [outcome.settle for outcome in outcomes if outcome.settle is not None]
    if not summaries:
        return None
    durations = np.array([summary.duration_s for summary in summaries])
    reasons = dict(Counter(summary.reason for summary in summaries).most_common())
    return Settling(reasons, float(np.median(durations)), float(durations.max()))


def stream_health(view: RunView, indices: Sequence[int]) -> list[StreamHealth]:
    """Return the health of every device's stream over the given trials."""
    streams: dict[str, list[Signals]] = {}
    for index in indices:
        for name, stream in view.run.signals(index).items():
            streams.setdefault(name, []).append(stream)
    return [_health(name, items) for name, items in streams.items()]


def as_json(items: Sequence[Any]) -> list[dict[str, Any]]:
    """Return dataclasses as JSON-ready values."""
    return [asdict(item) for item in items]


def _between(points: Sequence[Point]) -> float | None:
    means = [point.mean for point in points]
    return float(np.std(means, ddof=1)) if len(means) > 1 else None


def _health(name: str, streams: Sequence[Signals]) -> StreamHealth:
    reports = [stream_report(stream) for stream in streams if len(stream.time_s)]
    regular = [report for report in reports if math.isfinite(report.rate_hz)]
    samples = sum(len(stream.time_s) for stream in streams)
    lost = sum(stream.lost for stream in streams)
    return StreamHealth(
        device=name,
        nominal_hz=streams[0].rate_hz,
        actual_hz=float(np.median([report.rate_hz for report in regular])) if regular else 0.0,
        jitter_s=float(np.median([report.jitter_s for report in regular])) if regular else 0.0,
        samples=samples,
        lost=lost,
        lost_share=lost / (samples + lost) if samples + lost else 0.0,
        saturated=sum(stream.saturated for stream in streams),
        clock_offset_s=float(np.median([report.offset_s for report in reports])) if reports else None,
        clock_drift_ppm=_clock_drift_ppm([stream for stream in streams if len(stream.time_s)], reports),
        glitches=sum(report.glitches for report in reports),
    )


def _clock_drift_ppm(streams: Sequence[Signals], reports: Sequence[StreamReport]) -> float | None:
    """Return the drift from trial to trial, which tells most; within trials, where the device's clock began anew."""
    starts_s = np.array([s.device_time_s[0] for s in streams if s.device_time_s is not None])
    offsets_s = np.array([report.offset_s for report in reports])
    anew = (np.diff(starts_s) <= 0) | (np.abs(np.diff(offsets_s)) > JUMP_S)
    if len(starts_s) > 2 and not anew.any():
        return float(np.polyfit(starts_s - starts_s[0], offsets_s, 1)[0] * 1e6)
    within = [report.drift_ppm for report in reports if report.drift_ppm is not None]
    return float(np.median(within)) if within else None


def clock_text(stream: StreamHealth) -> tuple[str, str]:
    """Return a device's clock offset and drift: ``12.03 s``, ``5.2 ppm``; empty where they are not known."""
    offset_s, drift_ppm = stream.clock_offset_s, stream.clock_drift_ppm
    return (
        "" if offset_s is None else f"{offset_s:.4g} s",
        "" if drift_ppm is None else f"{drift_ppm:.3g} ppm",
    )
