"""How well a closed loop kept its time, from what it recorded of itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.report.data import RunView
from labrun.spec import LOOP_DEVICE


@dataclass(frozen=True, slots=True)
class LoopHealth:
    """A loop's own time over the trials that were looked at.

    Attributes
    ----------
    rate_hz
        Asked for.
    steps, missed
        How many steps ran, and how many of them began after their deadline.
    latency_median_s, latency_p99_s
        From the newest sample that a step used to the command it sent: median, and what 99 % stay below.
    latest_s
        The greatest delay of a step behind its deadline.
    """

    rate_hz: float
    steps: int
    missed: int
    latency_median_s: float
    latency_p99_s: float
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
    latency, late, missed = [], [], []
    for index in indices:
        stream = view.run.signals(index).get(LOOP_DEVICE)
        if stream is not None and len(stream.time_s):
            latency.append(stream.column("latency_s"))
            late.append(stream.column("late_s"))
            missed.append(stream.column("missed"))
    if not latency:
        return None
    known = np.concatenate(latency)
    known = known[np.isfinite(known)]
    median, high = np.quantile(known, [0.5, 0.99]) if len(known) else (np.nan, np.nan)
    misses = np.concatenate(missed)
    return LoopHealth(
        rate_hz=track.rate_hz,
        steps=len(misses),
        missed=int(np.count_nonzero(misses > 0)),
        latency_median_s=float(median),
        latency_p99_s=float(high),
        latest_s=float(np.max(np.concatenate(late))),
    )


def loop_words(health: LoopHealth) -> str:
    """Return it in a sentence."""
    latency = (
        f"latency {_ms(health.latency_median_s)} in the median, {_ms(health.latency_p99_s)} at 99 %"
        if np.isfinite(health.latency_median_s)
        else "no step had a sample to use"
    )
    missed = (
        f"{health.missed} of {health.steps} steps began late ({100 * health.missed_share:.2g} %), "
        f"by at most {_ms(health.latest_s)}"
        if health.missed
        else f"none of {health.steps} steps missed its deadline"
    )
    return f"at {health.rate_hz:g} Hz, {latency}; {missed}"


def _ms(time_s: float) -> str:
    return f"{1000 * time_s:.3g} ms"
