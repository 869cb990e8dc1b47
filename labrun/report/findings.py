"""Results of a run and their reliability, for `labrun show`, its JSON and the page of a run."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from labrun.estimate import Estimate
from labrun.experiment import PAST, condition_text
from labrun.report.conditions import ConditionResult, condition_results, most_promising
from labrun.report.data import RunView, by_condition, trial_tare_s
from labrun.report.statistics import Drift, Repeatability, Settling, drift, repeatability, settling
from labrun.report.timing import BenchTime, LoopHealth, StreamHealth, bench_time, loop_health, stream_health
from labrun.runner import unsettled
from labrun.search import RunResult
from labrun.store import Run, TrialOutcome, imported_channels, imported_source, remarks_of

_STREAMS_LOOKED_AT = 40
_MOST_CONDITIONS = 100
_MOST_NUMBERS = 6


@dataclass(frozen=True, slots=True)
class StoredFit:
    """One fit, read leniently: whatever lies there must not cost the rest of a report.

    Attributes
    ----------
    path
        Its numbers.
    numbers
        As they were written; empty if they cannot be read.
    fault
        Why they cannot be read; empty if they can.
    picture
        PNG, if it is still there.
    """

    path: Path
    numbers: Mapping[str, Any]
    fault: str = ""
    picture: bytes | None = None

    @property
    def model(self) -> str:
        """What was fitted."""
        return str(self.numbers.get("model", self.path.stem))

    @property
    def method(self) -> str:
        """The way of fitting."""
        return str(self.numbers.get("method", ""))

    @property
    def title(self) -> str:
        """``Model hinge``, with the way of fitting where that has another name."""
        return self.model + (f", by {self.method}" if self.method not in ("", self.model) else "")

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Parameters that have a number and an interval."""
        estimates = {}
        for name, entry in as_table(self.numbers.get("parameters")).items():
            value: Any = as_table(entry).get("value")
            interval = as_list(as_table(entry).get("ci95"))
            if is_number(value) and len(interval) == 2 and all(is_number(end) for end in interval):
                unit = str(entry.get("unit", ""))
                estimates[str(name)] = Estimate(float(value), (float(interval[0]), float(interval[1])), unit)
        return estimates

    def sentences(self, name: str) -> list[str]:
        """Return its ``findings`` or ``warnings``."""
        return [str(value) for value in as_list(self.numbers.get(name))]


def is_number(value: Any) -> bool:
    """Tell whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def as_list(value: Any) -> list[Any]:
    """Return a list as it is, and anything else as none."""
    return value if isinstance(value, list) else []


def as_table(value: Any) -> dict[Any, Any]:
    """Return a table as it is, and anything else as an empty one."""
    return value if isinstance(value, dict) else {}


@dataclass(frozen=True, slots=True)
class StoredGap:
    """The diagnosis that is kept with a run: its numbers as ``--json`` printed them, or why they cannot be read."""

    numbers: Mapping[str, Any]
    page: str | None = None
    fault: str = ""


@dataclass(frozen=True)
class Findings(RunView):
    """An open run with its fits and diagnoses, and quantities computed from it.

    Attributes
    ----------
    folder
        The run's folder; None for a ``run.h5`` that stands alone.
    finished
        Whether the run came to its end.
    result
        How it ended, its searches above all; None while it has not, or of a ``run.h5`` that stands alone.
    fits
        What `labrun fit` made of it.
    diagnosis
        The newest diagnosis that is kept with it.
    generations
        Of its search, if it has one.
    """

    folder: Path | None = None
    finished: bool = False
    result: RunResult | None = None
    fits: Sequence[StoredFit] = ()
    diagnosis: StoredGap | None = None
    generations: Sequence[Mapping[str, Any]] = ()

    @cached_property
    def channels(self) -> Mapping[str, Mapping[str, str]]:
        """Kind and unit of the channels of a recording made elsewhere; empty for a run."""
        return imported_channels(self.run.experiment_toml)

    @property
    def imported(self) -> bool:
        """Tell whether the trials were recorded elsewhere."""
        return "imported_from" in self.run.provenance

    @property
    def dry_run(self) -> bool:
        """Tell whether the bench was simulated."""
        return bool(self.run.provenance.get("dry_run"))

    @property
    def emulated(self) -> bool:
        """Tell whether emulators stood behind the drivers."""
        return bool(self.run.provenance.get("emulated"))

    @property
    def simulated_only(self) -> bool:
        """Tell whether it is a design: nothing of it was measured, and what speaks of a bench does not apply."""
        return self.experiment.kind == "design"

    @property
    def drawing(self) -> Path | None:
        """The drawing of a design, or None."""
        path = None if self.folder is None else self.folder / "drawing.png"
        return path if path is not None and self.simulated_only and path.is_file() else None

    @property
    def figure(self) -> Path | None:
        """The picture, if the run has made one."""
        return None if self.result is None else self.result.figure

    @cached_property
    def trials(self) -> dict[str, dict[str, int]]:
        """Number of trials by role and status: ``{"measure": {"done": 64}}``."""
        counters: dict[str, Counter[str]] = {}
        for outcome in self.run.outcomes:
            counters.setdefault(outcome.role, Counter())[outcome.status] += 1
        return {role: dict(counts) for role, counts in counters.items()}

    @cached_property
    def accepted(self) -> list[TrialOutcome]:
        """Trials that count."""
        return [outcome for outcome in self.run.outcomes if outcome.status == "done"]

    @cached_property
    def spoiled(self) -> list[TrialOutcome]:
        """Trials that were rejected or failed."""
        return [outcome for outcome in self.run.outcomes if outcome.status != "done"]

    @cached_property
    def reasons(self) -> dict[str, int]:
        """Reasons of rejected and failed trials, with their number, most frequent first."""
        return dict(Counter(f"{outcome.status}: {outcome.reason}" for outcome in self.spoiled).most_common())

    @cached_property
    def unsettled(self) -> int:
        """Number of accepted trials before which the bench had not come to rest."""
        return sum(unsettled(outcome) for outcome in self.run.outcomes)

    @cached_property
    def bench_time(self) -> BenchTime | None:
        """Time by activity; None if not recorded."""
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
    def conditions(self) -> list[ConditionResult]:
        """What each condition gave; the most promising first where there is a goal."""
        return most_promising(self, condition_results(self))

    @cached_property
    def objective_units(self) -> dict[str, str]:
        """Unit of every objective."""
        return {name: self.unit_of(name) for name in self.experiment.objectives}

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
    def settling(self) -> Settling | None:
        """Settling statistics; None if the experiment does not settle."""
        return settling(self.run.outcomes)

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
        """Tell whether the clock restarted during the run, as after a reboot."""
        starts = [outcome.started_s for outcome in self.run.outcomes]
        return not self.imported and any(later < earlier for earlier, later in pairwise(starts))

    @cached_property
    def damage(self) -> list[str]:
        """Damage of specimens: broken ones trial by trial, planned damage in one line."""
        planned = [outcome for outcome in self.run.outcomes if outcome.damage == PAST]
        messages = [
            f"trial {outcome.index}: {outcome.damage} ({condition_text(outcome.condition, self.experiment.units)})"
            for outcome in self.run.outcomes
            if outcome.damage and (outcome.damage != PAST or len(planned) == 1)
        ]
        if len(planned) > 1:
            numbers = ", ".join(str(outcome.index) for outcome in planned[:_MOST_NUMBERS])
            more = f" and {len(planned) - _MOST_NUMBERS} more" if len(planned) > _MOST_NUMBERS else ""
            messages.append(
                f"{len(planned)} trials took their specimens past the limit, as planned: trials {numbers}{more}"
            )
        return messages

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on single trials, one sentence each."""
        return remarks_of(self.run.events)

    def to_json(self) -> dict[str, Any]:
        """Return what `labrun show --json` prints: at most 100 conditions, including the confirmed best."""
        if self.channels:
            return self._recording_json()
        provenance, most = self.run.provenance, self.conditions[:_MOST_CONDITIONS]
        most += [result for result in self.conditions[_MOST_CONDITIONS:] if result.best]
        return {
            "run": str(self.run.path),
            "experiment": self.run.name,
            "title": self.experiment.title,
            "kind": self.experiment.kind,
            "seed": provenance.get("seed"),
            "dry_run": provenance.get("dry_run"),
            "emulated": self.emulated,
            "finished": self.finished,
            "trials": self.trials,
            "rejected_and_failed": self.reasons,
            "bench_time_s": self.bench_time_s,
            "best": self.best.to_json() if self.best is not None and self.finished else None,
            **({} if self.result is None else self.result.searches_to_json()),
            "conditions": [result.to_json(self.objective_units) for result in most],
            "conditions_total": len(self.conditions),
            "figure": None if self.figure is None else str(self.figure),
            "repeatability": [asdict(spread) for spread in self.repeatability],
            "drift": [asdict(trend) for trend in self.drift],
            "unsettled": self.unsettled,
            "damage": self.damage,
            "remarks": self.remarks,
            "settling": None if self.settling is None else asdict(self.settling),
            "streams": [asdict(stream) for stream in self.streams],
            "streams_from_trials": len(self.streams_looked_at),
            "faults": self.run.faults,
            "loop": None if self.loop is None else asdict(self.loop),
            "fits": [dict(fit.numbers) for fit in self.fits if not fit.fault],
        }

    def _recording_json(self) -> dict[str, Any]:
        """Return what a recording made elsewhere holds; a channel's rate is its median over the trials."""
        run = self.run
        rates: dict[str, list[float]] = {"input": [], "output": []}
        for outcome in run.outcomes:
            for name, stream in run.signals(outcome.index).items():
                rates.setdefault(name, []).append(stream.rate_hz)
        median_hz = {kind: float(np.median(rate)) if rate else 0.0 for kind, rate in rates.items()}
        return {
            "run": str(run.path),
            "experiment": run.name,
            "kind": "recording",
            "finished": True,  # an import is whole or absent
            "imported_from": str(run.provenance.get("imported_from", run.path)),
            "trials": len(run.outcomes),
            "duration_s": sum(outcome.duration_s for outcome in run.outcomes),
            "channels": [
                {
                    "name": name,
                    "kind": channel["kind"],
                    "unit": channel["unit"],
                    "rate_hz": median_hz[channel["kind"]],
                }
                for name, channel in self.channels.items()
            ],
            "conditions": [
                {
                    "condition": trials[0].condition,
                    "trials": len(trials),
                    "done": sum(trial.status == "done" for trial in trials),
                    "shortest_s": min(trial.duration_s for trial in trials),
                    "longest_s": max(trial.duration_s for trial in trials),
                    **_numbers_of_a_table(run, trials),
                }
                for trials in by_condition(run.outcomes).values()
            ],
            "faults": run.faults,
            "source": imported_source(run.experiment_toml),
        }


def _numbers_of_a_table(run: Run, trials: Sequence[TrialOutcome]) -> dict[str, dict[str, float]]:
    """Return the mean of every channel over trials that are single numbers; nothing for signals."""
    if any(trial.duration_s > 0.0 for trial in trials):
        return {}
    values: dict[str, list[float]] = {}
    for trial in trials:
        for stream in run.signals(trial.index).values():
            for name in stream.columns:
                values.setdefault(name, []).extend(stream.column(name))
    return {"means": {name: float(np.mean(column)) for name, column in values.items()}}
