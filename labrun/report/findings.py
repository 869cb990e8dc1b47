"""What `labrun show` tells of a run, or of a recording made elsewhere."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labrun.report.conditions import ConditionResult, condition_results, most_promising
from labrun.report.data import RunView, experiment_of
from labrun.report.statistics import Drift, Repeatability, Settling, as_json, drift, repeatability, settling
from labrun.report.stored_fits import StoredFit, stored_fits
from labrun.report.timing import LoopHealth, StreamHealth, loop_health, stream_health
from labrun.runner import unsettled
from labrun.search import Best, stored_result
from labrun.spec import Value, condition_key
from labrun.store import SPEC, Run, imported_channels

_STREAMS_LOOKED_AT = 40
_MOST_CONDITIONS = 100


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
    goal
        Objective and direction, if one has a goal.
    objective_units, condition_units
        Units of the objectives, and of the conditions' values.
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
    unsettled: int = 0
    emulated: bool = False
    fits: tuple[StoredFit, ...] = ()
    loop: LoopHealth | None = None
    conditions: tuple[ConditionResult, ...] = ()
    conditions_total: int = 0
    goal: tuple[str, str] | None = None
    objective_units: Mapping[str, str] = field(default_factory=dict)
    condition_units: Mapping[str, str] = field(default_factory=dict)

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
            "conditions": [result.to_json(self.objective_units) for result in self.conditions],
            "conditions_total": self.conditions_total,
            "figure": None if self.figure is None else str(self.figure),
            "repeatability": as_json(self.repeatability),
            "drift": as_json(self.drift),
            "unsettled": self.unsettled,
            "settling": None if self.settling is None else asdict(self.settling),
            "streams": as_json(self.streams),
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


def _evenly(items: list[int], most: int) -> list[int]:
    if len(items) <= most:
        return items
    return [items[k] for k in np.linspace(0, len(items) - 1, most).round().astype(int)]


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
        }


def is_imported(run: Run) -> bool:
    """Tell whether a run was recorded elsewhere: it has a ``recording.toml`` in place of an experiment file."""
    return bool(imported_channels(run.experiment_toml))


def recording_findings(run: Run) -> RecordingFindings:
    """Read what there is in a recording.

    Parameters
    ----------
    run
        For which `is_imported` holds.
    """
    rates: dict[str, list[float]] = {"input": [], "output": []}
    groups: dict[object, list[int]] = {}
    for number, outcome in enumerate(run.outcomes):
        groups.setdefault(condition_key(outcome.condition), []).append(number)
        for name, stream in run.signals(outcome.index).items():
            rates.setdefault(name, []).append(stream.rate_hz)
    median_hz = {kind: float(np.median(found)) if found else 0.0 for kind, found in rates.items()}
    origin = Path(run.provenance.get("imported_from", run.path))
    conditions = []
    for numbers in groups.values():
        trials = [run.outcomes[number] for number in numbers]
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
            for name, table in imported_channels(run.experiment_toml).items()
        ],
        conditions=conditions,
        faults=list(run.faults),
    )


def findings(run: Run) -> Findings | RecordingFindings:
    """Read what a run found, or what a recording holds.

    Parameters
    ----------
    run
        Open for reading; finished or not, measured or imported.
    """
    if is_imported(run):
        return recording_findings(run)
    experiment = experiment_of(run.experiment_toml, run.name)
    folder = run.path if run.path.is_dir() else run.path.parent
    result = stored_result(folder)
    best = result.best if result is not None else None
    view = RunView(run, experiment, best)
    conditions = most_promising(view, condition_results(view))
    looked_at = _evenly([outcome.index for outcome in run.outcomes], _STREAMS_LOOKED_AT)
    ends = [outcome.started_s + outcome.duration_s for outcome in run.outcomes]
    reasons = Counter(f"{o.status}: {o.reason}" for o in run.outcomes if o.status != "done")
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
        emulated=bool(run.provenance.get("emulated")),
        finished=result is not None or any(event["event"] == "finished" for event in run.events),
        trials=trials,
        spoiled=dict(reasons.most_common()),
        bench_time_s=max(ends) - run.outcomes[0].started_s if ends else 0.0,
        best=best,
        figure=result.figure if result is not None else None,
        repeatability=repeatability(view),
        drift=drift(view),
        settling=settling(run.outcomes),
        streams=stream_health(view, looked_at),
        streams_of=len(looked_at),
        faults=list(run.faults),
        unsettled=sum(unsettled(outcome) for outcome in run.outcomes),
        loop=loop_health(view, looked_at),
        fits=tuple(stored_fits(folder if (folder / SPEC).is_file() else None)),
        conditions=_most(conditions),
        conditions_total=len(conditions),
        goal=experiment.goal,
        objective_units={name: view.unit_of(name) for name in experiment.objectives},
        condition_units=experiment.units,
    )
