"""What `labrun show` tells of a run, or of a recording made elsewhere."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labrun.report.conditions import ConditionResult, condition_results, most_promising
from labrun.report.data import by_condition
from labrun.report.report_source import ReportSource
from labrun.report.statistics import Drift, Repeatability, Settling, settling
from labrun.report.stored_fits import StoredFit
from labrun.report.timing import LoopHealth, StreamHealth
from labrun.runner import unsettled
from labrun.search import Best, RunResult, stored_result
from labrun.spec import PAST, Experiment, Value, condition_text
from labrun.store import Run, TrialOutcome, imported_channels, imported_source, remarks_of

_MOST_CONDITIONS = 100
_MOST_NUMBERS = 6


@dataclass(frozen=True, slots=True)
class Findings:
    """What a run found, and how far it can be trusted.

    Attributes
    ----------
    run, experiment, title, kind
        Which run, of what.
    seed, dry_run, emulated
        As stored with it.
    finished
        Whether it came to its end.
    trials
        Number of trials by role and status: ``{"measure": {"done": 64}}``.
    spoiled
        Reasons of rejected and failed trials, with their number, most frequent first.
    bench_time_s
        From the first trial's start to the last one's end, by the run's clock.
    figure
        The picture, if there is one.
    streams_of
        How many trials the health of the streams was taken from, evenly over the run.
    faults
        What was found damaged on disk.
    unsettled
        Accepted trials before which the bench had not come to rest.
    fits
        What `labrun fit` made of it.
    loop
        How a closed loop kept its time.
    conditions
        What each condition gave; the most promising first where there is a goal, and at most 100 of them.
    conditions_total
        How many conditions there are.
    damage
        What trials did to their specimens, a sentence each.
    remarks
        What is to be told of single trials, a sentence each.
    goal
        Objective and direction, if one has a goal.
    objective_units, condition_units
        Units of the objectives, and of the conditions' values.
    result
        How the run ended, its searches above all; None while it has not, or of a ``run.h5`` that stands alone.
    """

    run: Path
    experiment: str
    title: str
    kind: str
    seed: int | None
    dry_run: bool | None
    finished: bool
    trials: dict[str, dict[str, int]]
    spoiled: dict[str, int]
    bench_time_s: float
    best: Best | None
    figure: Path | None
    repeatability: list[Repeatability]
    drift: list[Drift]
    settling: Settling | None
    streams: list[StreamHealth]
    streams_of: int
    faults: list[str]
    damage: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    unsettled: int = 0
    emulated: bool = False
    fits: tuple[StoredFit, ...] = ()
    loop: LoopHealth | None = None
    conditions: tuple[ConditionResult, ...] = ()
    conditions_total: int = 0
    goal: tuple[str, str] | None = None
    objective_units: Mapping[str, str] = field(default_factory=dict)
    condition_units: Mapping[str, str] = field(default_factory=dict)
    result: RunResult | None = None

    def to_json(self) -> dict[str, Any]:
        """Return everything, JSON-ready."""
        return {
            "run": str(self.run),
            "experiment": self.experiment,
            "title": self.title,
            "kind": self.kind,
            "seed": self.seed,
            "dry_run": self.dry_run,
            "emulated": self.emulated,
            "finished": self.finished,
            "trials": self.trials,
            "rejected_and_failed": self.spoiled,
            "bench_time_s": self.bench_time_s,
            "best": None if self.best is None else self.best.to_json(),
            **({} if self.result is None else self.result.searches_to_json()),
            "conditions": [result.to_json(self.objective_units) for result in self.conditions],
            "conditions_total": self.conditions_total,
            "figure": None if self.figure is None else str(self.figure),
            "repeatability": [asdict(one) for one in self.repeatability],
            "drift": [asdict(one) for one in self.drift],
            "unsettled": self.unsettled,
            "damage": list(self.damage),
            "remarks": list(self.remarks),
            "settling": None if self.settling is None else asdict(self.settling),
            "streams": [asdict(one) for one in self.streams],
            "streams_from_trials": self.streams_of,
            "faults": self.faults,
            "loop": None if self.loop is None else asdict(self.loop),
            "fits": [dict(fit.numbers) for fit in self.fits if not fit.fault],
        }


def _most(conditions: list[ConditionResult]) -> tuple[ConditionResult, ...]:
    """Return the first conditions, and the honest best among them in any case."""
    most = conditions[:_MOST_CONDITIONS]
    rest = conditions[_MOST_CONDITIONS:]
    return (*most, *(result for result in rest if result.best))


@dataclass(frozen=True, slots=True)
class ChannelFindings:
    """One channel: whether it is an ``"input"`` or an ``"output"``, its unit, and its median rate over the trials."""

    name: str
    kind: str
    unit: str
    rate_hz: float


@dataclass(frozen=True, slots=True)
class ConditionFindings:
    """The trials of one condition: how many, how many of them count, and how long the shortest and longest are."""

    condition: Mapping[str, Value]
    trials: int
    done: int
    shortest_s: float
    longest_s: float


@dataclass(frozen=True, slots=True)
class RecordingFindings:
    """A recording made elsewhere.

    Attributes
    ----------
    run
        Where it is: the run it was imported as, or the recording folder itself.
    experiment
        Its name.
    imported_from
        The folder it was read from.
    finished
        Whether all of it is there: an import is whole or absent.
    trials
        Their number.
    duration_s
        Of all trials together.
    faults
        What was found damaged on disk.
    source
        Where it comes from, as its file says: of a solver its program, version, mesh and load.
    """

    run: Path
    experiment: str
    imported_from: Path
    finished: bool
    trials: int
    duration_s: float
    channels: list[ChannelFindings]
    conditions: list[ConditionFindings]
    faults: list[str]
    source: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return everything, JSON-ready."""
        return {
            "run": str(self.run),
            "experiment": self.experiment,
            "kind": "recording",
            "finished": self.finished,
            "imported_from": str(self.imported_from),
            "trials": self.trials,
            "duration_s": self.duration_s,
            "channels": [asdict(channel) for channel in self.channels],
            "conditions": [asdict(condition) for condition in self.conditions],
            "faults": self.faults,
            "source": dict(self.source),
        }


def _recording_findings(run: Run, channels: Mapping[str, Mapping[str, str]]) -> RecordingFindings:
    rates: dict[str, list[float]] = {"input": [], "output": []}
    for outcome in run.outcomes:
        for name, stream in run.signals(outcome.index).items():
            rates.setdefault(name, []).append(stream.rate_hz)
    median_hz = {kind: float(np.median(found)) if found else 0.0 for kind, found in rates.items()}
    origin = Path(run.provenance.get("imported_from", run.path))
    conditions = []
    for trials in by_condition(run.outcomes).values():
        durations_s = [trial.duration_s for trial in trials]
        done = sum(trial.status == "done" for trial in trials)
        conditions.append(
            ConditionFindings(trials[0].condition, len(trials), done, min(durations_s), max(durations_s))
        )
    return RecordingFindings(
        run=run.path,
        experiment=run.name,
        imported_from=origin,
        finished=True,
        trials=len(run.outcomes),
        duration_s=sum(outcome.duration_s for outcome in run.outcomes),
        channels=[
            ChannelFindings(name, table["kind"], table["unit"], median_hz[table["kind"]])
            for name, table in channels.items()
        ],
        conditions=conditions,
        faults=list(run.faults),
        source=imported_source(run.experiment_toml),
    )


def findings(source: ReportSource) -> Findings | RecordingFindings:
    """Return what a run found, or what a recording holds."""
    run, experiment = source.run, source.experiment
    if channels := imported_channels(run.experiment_toml):  # a recording.toml in place of an experiment file
        return _recording_findings(run, channels)
    conditions = most_promising(source, condition_results(source))
    ends = [outcome.started_s + outcome.duration_s for outcome in run.outcomes]
    trials: dict[str, dict[str, int]] = {}
    for outcome in run.outcomes:
        by_status = trials.setdefault(outcome.role, {})
        by_status[outcome.status] = by_status.get(outcome.status, 0) + 1
    return Findings(
        run=run.path,
        experiment=run.name,
        title=experiment.title,
        kind=experiment.kind,
        seed=run.provenance.get("seed"),
        dry_run=run.provenance.get("dry_run"),
        emulated=source.emulated,
        finished=source.finished,
        trials=trials,
        spoiled=dict(Counter(f"{one.status}: {one.reason}" for one in source.spoiled).most_common()),
        bench_time_s=max(ends) - run.outcomes[0].started_s if ends else 0.0,
        best=source.best if source.finished else None,
        figure=source.figure,
        repeatability=source.repeatability,
        drift=source.drift,
        settling=settling(run.outcomes),
        streams=source.streams,
        streams_of=len(source.streams_looked_at),
        faults=list(run.faults),
        unsettled=sum(unsettled(outcome) for outcome in run.outcomes),
        loop=source.loop,
        damage=_damage(run.outcomes, experiment),
        remarks=remarks_of(run.events),
        fits=tuple(source.fits),
        conditions=_most(conditions),
        conditions_total=len(conditions),
        goal=experiment.goal,
        objective_units={name: source.unit_of(name) for name in experiment.objectives},
        condition_units=experiment.units,
        result=None if source.folder is None else stored_result(source.folder),
    )


def _damage(outcomes: Sequence[TrialOutcome], experiment: Experiment) -> tuple[str, ...]:
    """Return what became of specimens: what broke trial by trial, what was planned in one line."""
    planned = [one for one in outcomes if one.damage == PAST]
    told = [
        f"trial {one.index}: {one.damage} ({condition_text(one.condition, experiment.units)})"
        for one in outcomes
        if one.damage and (one.damage != PAST or len(planned) == 1)
    ]
    if len(planned) > 1:
        numbers = ", ".join(str(one.index) for one in planned[:_MOST_NUMBERS])
        more = f" and {len(planned) - _MOST_NUMBERS} more" if len(planned) > _MOST_NUMBERS else ""
        told.append(
            f"{len(planned)} trials took their specimens past the limit, as planned: trials {numbers}{more}"
        )
    return tuple(told)
