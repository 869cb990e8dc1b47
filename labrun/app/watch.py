"""Follow a run that another process executes."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from labrun.devices import Clock
from labrun.errors import LabrunError, RequestError
from labrun.experiment import Experiment, loads_experiment
from labrun.report import Snapshot, State, duration_text, event_text
from labrun.search import Best, BestSoFar, BestYet, resume_line, stored_result
from labrun.store import JOURNAL, SPEC, RunWatch, Trace, known_units, read_trace

_CLOCKS_AGREE_S = 60.0
_LAST_TRIALS = 6


class Watcher:
    """Polls a run; reads only, and locks nothing.

    Parameters
    ----------
    target
        The run folder, or the ``run.h5`` in it.
    clock
        Tells the time between two looks.
    channel
        Whose last trace to show, ``device.channel``; that of the objective if None.

    Raises
    ------
    RequestError
        There is nothing to watch: a packed file without its folder.
    """

    def __init__(self, target: Path, clock: Clock, channel: str | None = None) -> None:
        folder = target.parent if target.is_file() else target
        if not (folder / SPEC).is_file() and not (folder / JOURNAL).is_file():
            raise RequestError(
                f"{target} has no journal to follow: it is a finished run, packed into one file",
                hint=f"labrun show {target}",
            )
        self.folder = folder
        self._watch = RunWatch(folder, clock)
        self._channel = channel
        self._spec = ""
        self._spec_fault = ""
        self._experiment: Experiment | None = None
        self._trace: Trace | None = None
        self._units: dict[str, str] = {}
        self._trace_of = -1

    def look(self) -> Snapshot:
        """Return the run as it is now.

        Raises
        ------
        RequestError
            The trials have no such channel; names those there are.
        """
        watch = self._watch
        watch.poll()
        dead = watch.dead_process() if watch.ended is None else None
        if dead is not None:
            watch.poll()  # it may have said why just before it went
        self._read_spec()
        self._read_trace()
        state, reason = self._state(dead)
        statuses = [trial.status for trial in watch.trials.values()]
        latest = sorted(watch.trials.values(), key=lambda trial: -trial.index)[:_LAST_TRIALS]
        result = self._result() if state == "finished" else None
        return Snapshot(
            run=self.folder,
            experiment=self.folder.absolute().parent.name,
            title="" if self._experiment is None else self._experiment.title,
            state=state,
            reason=reason,
            trials={status: statuses.count(status) for status in ("done", "rejected", "failed")},
            expected=watch.expected,
            remaining_s=watch.remaining_s() if state == "running" else None,
            event=event_text(watch.last),
            event_utc=None if watch.last is None else str(watch.last.get("time_utc", "")),
            quiet_s=watch.quiet_s,
            last_trials=tuple(latest),
            best=self._best(),
            honest_best=result,
            trace=self._trace,
            units=self._units,
            resume=resume_line(self.folder) if state in ("silent", "dead", "stopped") else None,
            notes=tuple(self._notes()),
        )

    def _state(self, dead: int | None) -> tuple[State, str]:
        watch = self._watch
        if watch.last is None:
            return "starting", ""
        if watch.ended is not None:
            if watch.ended["event"] == "finished":
                return "finished", ""
            return "stopped", event_text(watch.ended)
        if dead is not None:
            return "dead", f"its process {dead} is gone: it was killed, or the machine was restarted"
        if watch.is_silent:
            return "silent", "nothing was written for longer than this run has ever paused"
        return "running", ""

    def _read_spec(self) -> None:
        if self._spec:
            return
        try:
            self._spec = (self.folder / SPEC).read_text(encoding="utf-8")
            self._experiment = loads_experiment(
                self._spec, self.folder.absolute().parent.name, plugins=False
            ).experiment
        except OSError:  # not there yet, or the network folder does not answer
            return
        except LabrunError as error:  # an imported recording
            self._spec_fault = str(error.args[0]).splitlines()[0]

    def _read_trace(self) -> None:
        trials = self._watch.trials
        newest = max((index for index, trial in trials.items() if trial.objectives), default=None)
        newest = max(trials, default=None) if newest is None else newest
        if newest is None or newest == self._trace_of:
            return
        trace = read_trace(self.folder, newest, self._wanted())
        if trace is None:
            return  # between trials/ and run.h5, or nothing was recorded: the last one stays
        if self._channel is not None and self._channel not in trace.channels:
            raise RequestError(
                f"trial {newest} of {self.folder} has no channel {self._channel!r}",
                hint=f"recorded were: {', '.join(trace.channels)}",
            )
        self._trace, self._trace_of = trace, newest
        if self._spec:
            self._units = known_units(self._spec, trace.channels)

    def _wanted(self) -> Sequence[str]:
        if self._channel is not None:
            return (self._channel,)
        if self._experiment is None:
            return ()
        return list(_channels_of(self._experiment))

    def _best(self) -> BestYet | None:
        if self._experiment is None or self._experiment.goal is None:
            return None
        so_far = BestSoFar(*self._experiment.goal, self._experiment.trial.repeats.min)
        for trial in self._watch.trials.values():
            so_far.take(trial)
        return so_far.best

    def _result(self) -> Best | None:
        try:
            result = stored_result(self.folder)
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return None if result is None else result.best

    def _notes(self) -> Iterable[str]:
        difference_s = self._watch.clock_difference_s
        if difference_s is not None and abs(difference_s) > _CLOCKS_AGREE_S:
            yield (
                f"the folder's file times and the run's own clock are {duration_text(abs(difference_s))} apart: "
                "the clocks differ, or this is a copy"
            )
        if self._spec_fault:
            yield f"the best is not known here: {self._spec_fault}"
        if self._watch.tail.unreadable:
            yield f"{self._watch.tail.unreadable} lines of the journal cannot be read"


def _channels_of(experiment: Experiment) -> Iterable[str]:
    """Yield channels by importance: of the goal, of other objectives, of the fit."""
    goal = experiment.goal
    names = ([] if goal is None else [goal[0]]) + list(experiment.objectives)
    yield from (channel for name in names if (channel := experiment.objectives[name].channel) is not None)
    if experiment.fit is not None:
        yield from experiment.fit.signals.values()
