"""Where the bench's time went, and how well streams, commands and loops kept theirs."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.devices import Pacing
from labrun.experiment import LOOP_DEVICE
from labrun.report.data import RunView
from labrun.report.text import milliseconds_text
from labrun.signals import Signals
from labrun.store import JUMP_S, StreamReport, TrialOutcome, stream_report

STEPS = ("move", "settle", "tare", "record", "safe pose", "store")
"""What a trial consists of, in this order."""


@dataclass(frozen=True, slots=True)
class BenchTime:
    """Bench time by activity.

    Attributes
    ----------
    steps
        For each of `STEPS` that took any time: seconds of every trial that has it.
    """

    steps: dict[str, list[float]]

    @property
    def total_s(self) -> float:
        """All trials together; the baseline before them and the pauses of an interrupted run are not counted."""
        return sum(sum(times) for times in self.steps.values())

    def of(self, step: str) -> float:
        """Return the time of one step over all trials, s."""
        return sum(self.steps.get(step, []))

    def median_s(self, step: str) -> float:
        """Return the median over the trials that have this step, s."""
        times = self.steps.get(step, [])
        return float(np.median(times)) if times else 0.0


def bench_time(
    events: Sequence[Mapping[str, Any]], outcomes: Sequence[TrialOutcome], tare_s: float
) -> BenchTime | None:
    """Read where the time went.

    Parameters
    ----------
    events
        The journal.
    outcomes
        Of the stored trials.
    tare_s
        How long a tare takes, by the experiment.

    Returns
    -------
    BenchTime or None
        None where the journal does not tell, as of an imported recording.
    """
    ends = {o.index: float(json.loads(o.checkpoint)["clock_s"]) for o in outcomes if o.checkpoint is not None}
    marks = _marks(events, ends)
    steps: dict[str, list[float]] = {name: [] for name in STEPS}
    for outcome in outcomes:
        if outcome.index in marks:
            for name, time_s in _parts(outcome, marks[outcome.index], tare_s).items():
                steps[name].append(max(time_s, 0.0))
    used = {name: times for name, times in steps.items() if sum(times) > 0}
    return BenchTime(used) if used else None


def _marks(events: Sequence[Mapping[str, Any]], ends: Mapping[int, float]) -> dict[int, dict[str, float]]:
    """Return when each trial, last executed, did what, by the run's clock, s; its end and the next one's begin, too."""
    marks: dict[int, dict[str, float]] = {}
    last: int | None = None
    for event in events:
        kind, index, clock_s = event["event"], event.get("index"), event.get("clock_s")
        if kind in ("resumed", "interrupted", "limit-reached"):
            last = None  # whoever comes back finds another clock, or the same one much later
        if clock_s is None or not isinstance(index, int):
            continue
        if kind == "prepare":
            if last is not None:
                marks[last]["next"] = clock_s
            marks[index], last = {}, index
        if index in marks:
            marks[index][kind] = clock_s
    for index, mark in marks.items():
        end = ends.get(index, mark.get("stopped"))
        marks[index] = mark if end is None else {**mark, "end": end}
    return marks


def _parts(outcome: TrialOutcome, marks: Mapping[str, float], tare_s: float) -> dict[str, float]:
    settle_s = outcome.settle.duration_s if outcome.settle is not None else 0.0
    tared_s = tare_s if outcome.tare else 0.0
    begin, record, safe, end = (marks.get(name) for name in ("prepare", "record", "safe-pose", "end"))
    if begin is None:
        return {}
    if record is None:
        return {"move": (settle_s if end is None else end - begin) - settle_s, "settle": settle_s}
    parts = {"move": record - begin - settle_s - tared_s, "settle": settle_s, "tare": tared_s}
    until = end if safe is None else safe
    if until is not None:
        parts["record"] = until - record
    if end is not None:
        parts |= {} if safe is None else {"safe pose": end - safe}
        parts |= {"store": marks["next"] - end} if "next" in marks and outcome.checkpoint is not None else {}
    return parts


LEAST_JITTER_S = 1e-8
"""Below this, jitter is the rounding of the stored times."""


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
        Run clock minus device clock, median over trials; None without samples, and where only times of one clock
        were kept, as in a recording made elsewhere. Sample times have it in them already.
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


def stream_health(view: RunView, indices: Sequence[int]) -> list[StreamHealth]:
    """Return the health of every device's stream over the given trials."""
    streams: dict[str, list[Signals]] = {}
    for index in indices:
        for name, stream in view.run.signals(index).items():
            streams.setdefault(name, []).append(stream)
    return [_health(name, items) for name, items in streams.items()]


def _health(name: str, streams: Sequence[Signals]) -> StreamHealth:
    reports = [stream_report(stream) for stream in streams if len(stream.time_s)]
    regular = [report for report in reports if math.isfinite(report.rate_hz)]
    samples = sum(len(stream.time_s) for stream in streams)
    lost = sum(stream.lost for stream in streams)
    offsets_s = [report.offset_s for report in reports if math.isfinite(report.offset_s)]
    return StreamHealth(
        device=name,
        nominal_hz=streams[0].rate_hz,
        actual_hz=float(np.median([report.rate_hz for report in regular])) if regular else 0.0,
        jitter_s=float(np.median([report.jitter_s for report in regular])) if regular else 0.0,
        samples=samples,
        lost=lost,
        lost_share=lost / (samples + lost) if samples + lost else 0.0,
        saturated=sum(stream.saturated for stream in streams),
        clock_offset_s=float(np.median(offsets_s)) if offsets_s else None,
        clock_drift_ppm=_clock_drift_ppm([stream for stream in streams if len(stream.time_s)], reports),
        glitches=sum(report.glitches for report in reports),
    )


def _clock_drift_ppm(streams: Sequence[Signals], reports: Sequence[StreamReport]) -> float | None:
    """Return the clock drift from trial to trial, or within trials if the device's clock restarted."""
    known = [
        (stream.device_time_s[0], report.offset_s)
        for stream, report in zip(streams, reports, strict=True)
        if stream.device_time_s is not None and math.isfinite(report.offset_s)
    ]
    starts_s, offsets_s = np.reshape(known, (-1, 2)).T
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


def command_health(events: Sequence[Mapping[str, Any]]) -> dict[str, Pacing]:
    """Return how evenly each device's commands went out over a run; empty where no device tells.

    Median and 99th percentile are the medians over trials of each trial's own; the worst is the greatest of all.
    """
    by_device: dict[str, list[Pacing]] = {}
    for event in events:
        if event["event"] == "commands" and event["sent"]:
            pacing = Pacing(**{field.name: event[field.name] for field in fields(Pacing)})
            by_device.setdefault(event["device"], []).append(pacing)
    return {
        device: Pacing(
            pacings[0].rate_hz,
            sum(pacing.sent for pacing in pacings),
            sum(pacing.missed for pacing in pacings),
            float(np.median([pacing.late_median_s for pacing in pacings])),
            float(np.median([pacing.late_p99_s for pacing in pacings])),
            max(pacing.late_worst_s for pacing in pacings),
        )
        for device, pacings in by_device.items()
    }


@dataclass(frozen=True, slots=True)
class LoopHealth:
    """A loop's own time over the trials that were looked at.

    Attributes
    ----------
    rate_hz
        Asked for.
    steps, missed
        How many steps fell due, and how many of them came too late or were skipped.
    latency_median_s, latency_p99_s
        From the newest sample that a step used to the command it sent: median, and what 99 % stay below.
    reaction_median_s, reaction_p99_s
        From when a sample was received to the first command made of it, likewise; nan where no step tells.
    latest_s
        The greatest delay of a step behind its deadline.
    """

    rate_hz: float
    steps: int
    missed: int
    latency_median_s: float
    latency_p99_s: float
    reaction_median_s: float
    reaction_p99_s: float
    latest_s: float

    @property
    def missed_share(self) -> float:
        """Share of the steps that missed their deadline."""
        return self.missed / self.steps if self.steps else 0.0


def loop_health(view: RunView, indices: Sequence[int]) -> LoopHealth | None:
    """Return how the loop kept its time in these trials; None if the run has no loop, or no step was recorded."""
    track = view.experiment.track
    if track is None:
        return None
    latency, reaction, late, missed = [], [], [], []
    skipped = 0
    for index in indices:
        stream = view.run.signals(index).get(LOOP_DEVICE)
        if stream is not None and len(stream.time_s):
            latency.append(stream.column("latency_s"))
            if "reaction_s" in stream.columns:  # runs of before had none
                reaction.append(stream.column("reaction_s"))
            late.append(stream.column("late_s"))
            skipped += stream.lost
            missed.append(stream.column("missed"))
    if not latency:
        return None
    misses = np.concatenate(missed)
    return LoopHealth(
        rate_hz=track.rate_hz,
        steps=len(misses) + skipped,
        missed=int(np.count_nonzero(misses > 0)) + skipped,
        latency_median_s=_quantile(latency, 0.5),
        latency_p99_s=_quantile(latency, 0.99),
        reaction_median_s=_quantile(reaction, 0.5),
        reaction_p99_s=_quantile(reaction, 0.99),
        latest_s=float(np.max(np.concatenate(late))),
    )


def _quantile(parts: Sequence[FloatArray], share: float) -> float:
    """Return a quantile of the finite values; nan without any."""
    known = np.concatenate(parts) if parts else np.empty(0)
    known = known[np.isfinite(known)]
    return float(np.quantile(known, share)) if len(known) else math.nan


def loop_words(health: LoopHealth) -> str:
    """Return it in a sentence."""
    median, high = (milliseconds_text(seconds) for seconds in (health.latency_median_s, health.latency_p99_s))
    latency = (
        f"latency {median} in the median, {high} at 99 %"
        if np.isfinite(health.latency_median_s)
        else "no step had a sample to use"
    )
    if np.isfinite(health.reaction_median_s):
        median, high = (
            milliseconds_text(seconds) for seconds in (health.reaction_median_s, health.reaction_p99_s)
        )
        latency += f"; a sample is acted on {median} after it was received in the median, {high} at 99 %"
    missed = (
        f"{health.missed} of {health.steps} steps came late or were skipped ({100 * health.missed_share:.2g} %), "
        f"by at most {milliseconds_text(health.latest_s)}"
        if health.missed
        else f"none of {health.steps} steps missed its deadline"
    )
    return f"at {health.rate_hz:g} Hz, {latency}; {missed}"
