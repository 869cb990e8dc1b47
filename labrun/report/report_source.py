"""Everything a report tells of, read once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from labrun.report.data import RunView, trial_tare_s
from labrun.report.statistics import Drift, Repeatability, drift, repeatability
from labrun.report.stored_fits import StoredFit
from labrun.report.timing import BenchTime, LoopHealth, StreamHealth, bench_time, loop_health, stream_health
from labrun.store import TrialOutcome

_STREAMS_LOOKED_AT = 40


@dataclass(frozen=True, slots=True)
class StoredGap:
    """The diagnosis that is kept with a run: its numbers as ``--json`` printed them, or why they cannot be read."""

    numbers: Mapping[str, Any]
    page: str | None = None
    fault: str = ""


@dataclass(frozen=True)
class ReportSource(RunView):
    """A run with what lies beside it and what was computed from it.

    Attributes
    ----------
    folder
        The run's folder; None for a ``run.h5`` that stands alone.
    finished
        Whether the run came to its end.
    figure
        The picture, if the run has made one.
    fits
        What `labrun fit` made of it.
    diagnosis
        The newest diagnosis that is kept with it.
    generations
        Of its search, if it has one.
    """

    folder: Path | None = None
    finished: bool = False
    figure: Path | None = None
    fits: Sequence[StoredFit] = ()
    diagnosis: StoredGap | None = None
    generations: Sequence[Mapping[str, Any]] = ()

    @property
    def imported(self) -> bool:
        """Whether the trials were recorded elsewhere."""
        return "imported_from" in self.run.provenance

    @property
    def dry_run(self) -> bool:
        """Whether the bench was simulated."""
        return bool(self.run.provenance.get("dry_run"))

    @property
    def emulated(self) -> bool:
        """Whether emulators stood behind the drivers."""
        return bool(self.run.provenance.get("emulated"))

    @cached_property
    def accepted(self) -> list[TrialOutcome]:
        """Trials that count."""
        return [outcome for outcome in self.run.outcomes if outcome.status == "done"]

    @cached_property
    def spoiled(self) -> list[TrialOutcome]:
        """Trials that were rejected or failed."""
        return [outcome for outcome in self.run.outcomes if outcome.status != "done"]

    @cached_property
    def bench_time(self) -> BenchTime | None:
        """Where the bench time went; None where nobody noted it."""
        return bench_time(self.run.events, self.run.outcomes, trial_tare_s(self.experiment))

    @cached_property
    def bench_time_s(self) -> float:
        """Bench time of all trials, or at least how long they were recorded, s."""
        if self.bench_time is not None:
            return self.bench_time.total_s
        return sum(outcome.duration_s for outcome in self.run.outcomes)

    @cached_property
    def wall_time_s(self) -> float | None:
        """Time on the wall between the first and the last trial that was noted, s; pauses included."""
        times = [
            datetime.fromisoformat(event["time_utc"])
            for event in self.run.events
            if event["event"] in ("prepare", "trial") and "time_utc" in event
        ]
        return (times[-1] - times[0]).total_seconds() if len(times) > 1 else None

    @cached_property
    def repeatability(self) -> list[Repeatability]:
        """Spread within conditions, by objective."""
        return repeatability(self)

    def sd_of(self, objective: str) -> float | None:
        """Return the spread of an objective within a condition; None if nothing was repeated."""
        return next((item.sd for item in self.repeatability if item.objective == objective), None)

    @cached_property
    def drift(self) -> list[Drift]:
        """Drift by reference trials, by objective."""
        return drift(self)

    @cached_property
    def streams_looked_at(self) -> list[int]:
        """Trials whose samples were looked at: all, or so many evenly over the run."""
        indices = [outcome.index for outcome in self.run.outcomes]
        if len(indices) <= _STREAMS_LOOKED_AT:
            return indices
        return [indices[k] for k in np.linspace(0, len(indices) - 1, _STREAMS_LOOKED_AT).round().astype(int)]

    @cached_property
    def streams(self) -> list[StreamHealth]:
        """Rates, jitter and losses, by device."""
        return stream_health(self, self.streams_looked_at)

    @cached_property
    def loop(self) -> LoopHealth | None:
        """How a closed loop kept its time; None without one."""
        return loop_health(self, self.streams_looked_at)

    @cached_property
    def clock_restarted(self) -> bool:
        """Whether the run's clock began anew in its course, as after a restart of the machine."""
        starts = [outcome.started_s for outcome in self.run.outcomes]
        return not self.imported and any(later < earlier for earlier, later in pairwise(starts))
