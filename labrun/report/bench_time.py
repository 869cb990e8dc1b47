"""Where a run's bench time went, from its journal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labrun.store import TrialOutcome

STEPS = ("move", "settle", "tare", "record", "safe pose", "store")
"""What a trial consists of, in this order."""


@dataclass(frozen=True, slots=True)
class BenchTime:
    """Time by what was done with it.

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


@dataclass(slots=True)
class _Marks:
    """When the last execution of a trial did what, by the run's clock, s."""

    prepare: float
    record: float | None = None
    safe_pose: float | None = None
    stopped: float | None = None
    gap_s: float | None = None


@dataclass(slots=True)
class _Reading:
    """The journal as far as it was read."""

    trials: dict[int, _Marks] = field(default_factory=dict)
    last: int | None = None
    """Trial that ended last in this session; the time up to the next one is the storing of it."""


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
    ends = {o.index: float(o.checkpoint["clock_s"]) for o in outcomes if o.checkpoint is not None}
    reading = _Reading()
    for event in events:
        _take(event, reading, ends)
    steps: dict[str, list[float]] = {name: [] for name in STEPS}
    for outcome in outcomes:
        marks = reading.trials.get(outcome.index)
        if marks is not None:
            end = ends.get(outcome.index, marks.stopped)
            for name, time_s in _parts(outcome, marks, end, tare_s).items():
                steps[name].append(max(time_s, 0.0))
    used = {name: times for name, times in steps.items() if sum(times) > 0}
    return BenchTime(used) if used else None


def _take(event: Mapping[str, Any], reading: _Reading, ends: Mapping[int, float]) -> None:
    kind, index, clock_s = event["event"], event.get("index"), event.get("clock_s")
    if kind in ("resumed", "interrupted", "limit-reached"):
        reading.last = None  # whoever comes back finds another clock, or the same one much later
    if clock_s is None:
        return
    if kind == "prepare" and isinstance(index, int):
        if reading.last is not None and reading.last in ends:
            reading.trials[reading.last].gap_s = clock_s - ends[reading.last]
        reading.trials[index] = _Marks(clock_s)
        reading.last = index
    elif isinstance(index, int) and (marks := reading.trials.get(index)) is not None:
        if kind == "record":
            marks.record = clock_s
        elif kind == "safe-pose":
            marks.safe_pose = clock_s
        elif kind == "stopped":
            marks.stopped = clock_s


def _parts(outcome: TrialOutcome, marks: _Marks, end: float | None, tare_s: float) -> dict[str, float]:
    settle_s = outcome.settle.duration_s if outcome.settle is not None else 0.0
    tared_s = tare_s if outcome.tare else 0.0
    if marks.record is None:
        whole = end - marks.prepare if end is not None else settle_s
        return {"move": whole - settle_s, "settle": settle_s}
    parts = {"move": marks.record - marks.prepare - settle_s - tared_s, "settle": settle_s, "tare": tared_s}
    recorded_until = marks.safe_pose if marks.safe_pose is not None else end
    if recorded_until is not None:
        parts["record"] = recorded_until - marks.record
    if marks.safe_pose is not None and end is not None:
        parts["safe pose"] = end - marks.safe_pose
    if marks.gap_s is not None:
        parts["store"] = marks.gap_s
    return parts
