"""Everything a report tells of, read once."""

from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from labrun.report.bench_time import BenchTime, bench_time
from labrun.report.data import RunView
from labrun.report.loop_health import LoopHealth, loop_health
from labrun.report.recorded import experiment_of, trial_tare_s
from labrun.report.statistics import (
    Drift,
    Repeatability,
    StreamHealth,
    drift,
    repeatability,
    stream_health,
)
from labrun.search.leaders import t_interval
from labrun.search.result import Best, stored_result
from labrun.spec.experiment import Experiment
from labrun.store.folder import SPEC
from labrun.store.reading import Run
from labrun.store.trial import TrialOutcome

_STREAMS_LOOKED_AT = 40


@dataclass(frozen=True)
class ReportSource:
    """A run with what was computed from it.

    Attributes
    ----------
    run
        Open for reading.
    view
        The run as figures read it.
    folder
        The run's folder; None for a ``run.h5`` that stands alone.
    finished
        Whether the run came to its end.
    figure
        The picture that was drawn at its end, if it is still there.
    """

    run: Run
    view: RunView
    folder: Path | None
    finished: bool
    figure: Path | None

    @property
    def experiment(self) -> Experiment:
        """What the run did."""
        return self.view.experiment

    @property
    def best(self) -> Best | None:
        """The honest best; None without a goal, or before confirming trials."""
        return self.view.best

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
        return repeatability(self.view)

    def sd_of(self, objective: str) -> float | None:
        """Return the spread of an objective within a condition; None if nothing was repeated."""
        return next((item.sd for item in self.repeatability if item.objective == objective), None)

    @cached_property
    def drift(self) -> list[Drift]:
        """Drift by reference trials, by objective."""
        return drift(self.view)

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
        return stream_health(self.view, self.streams_looked_at)

    @cached_property
    def loop(self) -> LoopHealth | None:
        """How a closed loop kept its time; None without one."""
        return loop_health(self.view, self.streams_looked_at)

    @cached_property
    def clock_restarted(self) -> bool:
        """Whether the run's clock began anew in its course, as after a restart of the machine."""
        starts = [outcome.started_s for outcome in self.run.outcomes]
        return not self.imported and any(later < earlier for earlier, later in pairwise(starts))


def read_source(run: Run) -> ReportSource:
    """Read a run for its report.

    Parameters
    ----------
    run
        Open for reading; finished or not, packed or not, measured or imported.
    """
    folder = run.path if run.path.is_dir() else run.path.parent
    alone = not (folder / SPEC).is_file()
    experiment = experiment_of(run.experiment_toml, run.name)
    result = None if alone else stored_result(folder)
    ended = any(event["event"] == "finished" for event in run.events)
    # A run is packed when it ends, so a packed file that stands alone, without the journal's last lines, is whole.
    finished = result is not None or ended or run.path.is_file()
    view = RunView(run, experiment, None)
    best = result.best if result is not None else confirmed_best(view)
    figure = result.figure if result is not None else None
    return ReportSource(
        run=run,
        view=RunView(run, experiment, best),
        folder=None if alone else folder,
        finished=finished,
        figure=figure if figure is not None and figure.is_file() else None,
    )


def confirmed_best(view: RunView) -> Best | None:
    """Return the honest best from the confirming trials that are there; None if there are none.

    What a finished run keeps in its result, for a packed file alone and for a run that stopped close to its end.
    """
    goal = view.experiment.goal
    if goal is None:
        return None
    confirmed = view.points(goal[0], roles=("confirm",))
    if not confirmed:
        return None
    winner = confirmed[0]
    everything = np.concatenate([point.values for point in view.points(goal[0])])
    return Best(
        parameters=winner.condition,
        objective_name=goal[0],
        value=winner.mean,
        ci95=t_interval(winner.values),
        unit=view.unit_of(goal[0]),
        luckiest=float(everything.max() if goal[1] == "maximise" else everything.min()),
        trials=len(winner.values),
    )
