"""A session at the bench: conditions in, measurements out; every trial stored on the way."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Self

from labrun.devices import Clock
from labrun.devices.clock import RealClock
from labrun.errors import DeviceError, ExperimentError, LimitExceededError, RecordingError
from labrun.experiment import Condition, Experiment, RepeatRule, condition_text
from labrun.interrupts import Interrupted, Interrupts, handled
from labrun.runner.asking import AutoConfirm, Person
from labrun.runner.bench import Bench
from labrun.runner.by_hand import SET_ASIDE, Mounting, Mountings
from labrun.runner.damage import Damage, Worn
from labrun.runner.measurement import OUTLIER, Measurement, Order, block_order, find_outliers, needs_another
from labrun.runner.motion import MotionMaker
from labrun.runner.plan import check_wiring
from labrun.runner.recording import Recorder, TrialRequest, record_planned
from labrun.runner.rig import Rig
from labrun.runner.safety import LimitReached
from labrun.runner.settle import needs_baseline, unsettled
from labrun.runner.trial import TrialRunner
from labrun.store import Role, RunFolder, TrialOutcome


class Progress:
    """Progress callbacks of the runner and the searches."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def total(self, trials: int | None) -> None:
        """Set the largest possible number of trials; None if unknown."""

    def phase(self, text: str) -> None:
        """Announce the current step: "settle", "record"."""

    def trial(self, outcome: TrialOutcome, done: int, total: int | None, remaining_s: float | None) -> None:
        """Report a trial that has just been stored."""

    def best(self, condition: Mapping[str, float | str], value: float, unit: str) -> None:
        """Report the best condition so far."""

    def note(self, text: str) -> None:
        """Report something worth a line."""


class SilentProgress(Progress):
    """Says nothing."""


_COME_BACK_S = 10.0
"""How long a device that failed may stay away before the run ends: a plug put back takes some seconds to be found."""
_TRY_AGAIN_S = 0.5
_HUNG_S = 1.0
"""A call of a device that lasts longer hangs, once somebody asks: the watchdog, or a signal to stop."""
_MOST_FAILURES = 10
"""So many failed trials in a row end a run that skips or repeats each: a night is not worn out in minutes."""
_MOST_RAISED = 5
"""So many trials in a row for which an objective's plugin raises the same at the same line end the run."""


class Session:
    """Measures conditions on a rig, in an order and with a stop behaviour one can trust.

    Resuming is replay: whatever asks this session for measurements asks again from the start, and a trial that the
    folder already holds is taken from there. Only what is missing runs, from the checkpoint of the trial before it.

    Parameters
    ----------
    experiment
        What a trial is, how often it is repeated, what is an outlier.
    folder
        Where trials go; may hold some already.
    seed
        Of order and device noise: the same seed gives the same run.
    limit
        Stop, resumably, after this many new trials.
    recorder
        How a trial is recorded, see `labrun.runner.Recorder`.
    person
        Who mounts what is set by hand; one who has always done it if None.
    motions
        Those made for the plan, of the same experiment.
    worn
        Specimens that earlier runs left damaged.

    Raises
    ------
    SpecError
        The file names a joint, channel or device that the rig does not have.
    """

    def __init__(
        self,
        experiment: Experiment,
        rig: Rig,
        folder: RunFolder,
        clock: Clock,
        seed: int,
        progress: Progress | None = None,
        limit: int | None = None,
        recorder: Recorder = record_planned,
        person: Person | None = None,
        motions: MotionMaker | None = None,
        worn: Sequence[Worn] = (),
        taken: Callable[[TrialOutcome], object] | None = None,
    ) -> None:
        self.motions = MotionMaker(experiment) if motions is None else motions
        """Motion of each condition."""
        check_wiring(experiment, rig, self.motions.joints)
        self._experiment = experiment
        self._rig = rig
        self._folder = folder
        self._seed = seed
        self._progress: Progress = progress if progress is not None else SilentProgress()
        self._limit = limit
        self._told = taken
        self._interrupts = Interrupts()
        self._bench = Bench(rig, clock, self._check_stop, rig.beat)
        self._trials = TrialRunner(
            experiment,
            self._bench,
            folder,
            self.motions,
            seed=seed,
            phase=self._progress.phase,
            recorder=recorder,
            person=person or AutoConfirm(),
            wait=self._wait,
            may_correct=self._may_correct,
            correct=self._correct,
        )
        self._stored = folder.outcomes()
        self._hands = Mountings(
            experiment.by_hand,
            experiment.units,
            person or AutoConfirm(),
            folder.journal,
            self._wait,
            self._set_aside,
            lambda mounting: self._damage.is_whole(mounting.values),
            experiment.kind == "cmaes",
        )
        self._damage = Damage(experiment.damage, experiment.by_hand, worn)
        self._mounting: int | None = None
        self._stopwatch = RealClock()
        self._started_s = self._stopwatch.now()
        self._since_reference: int | None = None
        self._decided = 0
        """Index from which on no trial's values have decided anything yet."""
        self._previous: TrialOutcome | None = None
        self._expected: int | None = None
        self._warned = False
        self._failures = 0
        self._raised = ("", 0)
        self.index = 0
        """Index of the next trial."""
        self.new_trials = 0
        """Trials that really ran in this session, not taken from the folder."""
        self.outcomes: list[TrialOutcome] = []
        """Every trial of the run so far, in the order of execution."""

    def expect(self, trials: int | None) -> None:
        """Announce the number of trials of the run; None if unknown."""
        self._expected = trials
        self._progress.total(trials)

    def measure(
        self,
        conditions: Sequence[Condition],
        *,
        role: Role = "measure",
        repeats: RepeatRule | None = None,
        order: Order = "shuffled",
    ) -> list[Measurement]:
        """Measure conditions: blocks of one repeat each, until every one has as many as the rule asks for.

        What is set by hand is mounted once for all trials of its values, as often as the file says; the rule then
        holds within each mounting.

        Parameters
        ----------
        conditions
            What to measure, in the units of the experiment file.
        repeats
            Instead of the file's own rule.
        order
            Within a block.

        Returns
        -------
        list of Measurement
            One a condition, in the order of `conditions`, with rejected and failed trials among the outcomes.

        Raises
        ------
        Interrupted
            Ctrl-C, SIGTERM or SIGHUP; actuators are stopped, data is kept.
        LimitReached
            As many new trials as asked for are done.
        DeviceError, LimitExceededError, SettleError, StoreError
            The run ends, resumably.
        RecordingError
            The folder holds trials of another plan.
        """
        rule = repeats if repeats is not None else self._experiment.trial.repeats
        if self._expected is None:
            self.expect(None)
        measurements = [Measurement(condition, role, ()) for condition in conditions]
        self._decided = self.index
        self._tell_worn(conditions)
        with self._stopping_when_asked():
            self._hands.plan(
                conditions, order, seed=self._seed, trial_index=self.index, damages=self._damage.would
            )
            while mounting := self._hands.next(self.index):
                self._mounting = mounting.number
                self._measure_block(mounting, measurements, rule, order)
            self._check_stop()
        return [self._as_marked(item) for item in measurements]

    @contextmanager
    def _stopping_when_asked(self) -> Iterator[None]:
        """Stop the actuators as soon as a signal asks to stop; the run sees it at its next look at the bench.

        A signal therefore never cuts a file that is being written.
        """
        with handled() as self._interrupts, self._interrupts.held(self._rig.safe_stop, self._hung_call):
            try:
                yield
            except Interrupted as error:
                if self._rig.unstopped:
                    reasons = "; ".join(self._rig.unstopped)
                    raise Interrupted(error.number, f": {reasons}; data is kept") from error
                raise

    def _hung_call(self) -> DeviceError | None:
        """Return what to raise in the place of a call of a device that does not return; None if none hangs."""
        error = self._rig.calls.hung(_HUNG_S)
        if error is not None:
            self._rig.beat()
        return error

    def _tell_worn(self, conditions: Sequence[Condition]) -> None:
        """Say which specimens earlier runs left damaged; refuse a plan of nothing else."""
        known = self._damage.known(conditions)
        for text in known:
            self._progress.note(text)
        if (
            known
            and not self.outcomes
            and not any(self._damage.is_whole(condition) for condition in conditions)
        ):
            raise ExperimentError(
                f"nothing is left to measure: {known[0]}",
                hint="name new specimens by names of their own; or, where they go by the old names, "
                "--set damage.fresh=true",
            )

    def _measure_block(
        self, mounting: Mounting, measurements: list[Measurement], rule: RepeatRule, order: Order
    ) -> None:
        """Measure the conditions of one mounting, in place, until each has as many repeats as the rule asks for."""
        for part in (mounting.positions, mounting.last):
            while positions := self._needed(part, mounting.number, measurements, rule):
                for position in block_order(positions, order, seed=self._seed, trial_index=self.index):
                    if not self._is_whole(measurements[position]):
                        continue
                    if not self._hands.in_place(mounting, self.index, stored=self._is_stored(self.index)):
                        return
                    if measurements[position].role == "measure":
                        self._reference_if_due()
                    measurements[position] = self._repeat(measurements[position])
                if rule.min < rule.max or self._experiment.trial.outliers.rule != "none":
                    self._decided = self.index
                for position in part:
                    self._reject_outliers(measurements[position].of_mounting(mounting.number))
                    measurements[position] = self._as_marked(measurements[position])

    def _needed(
        self, part: Sequence[int], mounting: int | None, measurements: Sequence[Measurement], rule: RepeatRule
    ) -> list[int]:
        """Return the positions that want another repeat in this mounting, and whose specimen can still give one."""
        return [
            position
            for position in part
            if self._is_whole(measurements[position])
            and needs_another(measurements[position].of_mounting(mounting), rule)
        ]

    def _is_whole(self, measurement: Measurement) -> bool:
        return self._damage.is_whole(measurement.condition)

    def _as_marked(self, measurement: Measurement) -> Measurement:
        """Return a measurement with its trials as they are judged by now."""
        return replace(measurement, outcomes=tuple(self.outcomes[o.index] for o in measurement.outcomes))

    def _set_aside(self, mounting: int) -> None:
        """Take back the trials of a mounting that was wrong; they stay on disk."""
        reason = f"{SET_ASIDE}mounting {mounting} was taken back"
        self._mark({o.index: reason for o in self.outcomes if o.mounting == mounting and o.status == "done"})
        self._damage.forget(mounting)

    def _may_correct(self, index: int) -> bool:
        """Tell whether a stored trial's values may change: what comes next must not follow from those of before."""
        return (
            self._decided <= index < len(self.outcomes)
            and self.outcomes[index].status == "done"
            and self._experiment.damage is None
        )

    def _correct(self, index: int, objectives: Mapping[str, float]) -> None:
        """Replace values of a stored trial that were typed wrongly."""
        self._folder.correct(index, objectives)
        self.outcomes[index] = self.outcomes[index].corrected(objectives)

    def _mark(self, reasons: Mapping[int, str]) -> None:
        """Reject trials that counted so far."""
        for index, reason in reasons.items():
            stored = self._stored.get(index)
            if stored is None or stored.status != "rejected":
                self._folder.mark(index, "rejected", reason)
            self.outcomes[index] = self.outcomes[index].marked("rejected", reason)

    def _wait(self) -> None:
        self._check_stop()
        self._rig.beat()
        self._bench.clock.sleep(self._bench.clock.poll_s)

    def _check_stop(self) -> None:
        self._interrupts.check()

    def _reference_if_due(self) -> None:
        reference = self._experiment.trial.reference
        if reference is None:
            return
        if self._since_reference is None or self._since_reference >= reference.every:
            self._since_reference = 0
            self._repeat(Measurement(reference.condition, "reference", ()))
        self._since_reference += 1

    def _repeat(self, measurement: Measurement) -> Measurement:
        """Run one repeat, with the retries the file allows after a device's fault."""
        table = self._experiment.trial
        repeat = len(measurement.outcomes)
        attempt = 0
        outcomes = measurement.outcomes
        while True:
            request = TrialRequest(
                self.index, measurement.condition, repeat, measurement.role, attempt, self._mounting
            )
            outcome = self._taken(request) or self._run(request)
            outcomes = (*outcomes, outcome)
            attempt += 1
            if outcome.status != "failed" or table.on_fault != "retry-trial" or attempt > table.retries:
                return replace(measurement, outcomes=outcomes)

    def _is_stored(self, index: int) -> bool:
        outcome = self._stored.get(index)
        return outcome is not None and outcome.checkpoint is not None

    def _taken(self, request: TrialRequest) -> TrialOutcome | None:
        """Return the trial from the folder, if it is there whole."""
        if not self._is_stored(request.index):
            return None
        outcome = self._stored[request.index]
        if outcome.condition != dict(request.condition) or outcome.role != request.role:
            raise RecordingError(
                f"trial {request.index} of {self._folder.path} measured {condition_text(outcome.condition)} "
                f"({outcome.role}), "
                f"but the plan has {condition_text(request.condition)} ({request.role}) there",
                hint="spec.toml or provenance.json of the run was edited, or this version of labrun orders trials "
                "differently; the stored trials stay readable, start a new run for the others",
            )
        if outcome.reason.startswith((OUTLIER, SET_ASIDE)):
            # Rejected later, by what followed: at this point of the run it still counted.
            outcome = outcome.marked("done", "")
        return self._note(outcome)

    def _run(self, request: TrialRequest) -> TrialOutcome:
        if self._limit is not None and self.new_trials >= self._limit:
            raise LimitReached(f"{self.new_trials} new trials are done, as many as --limit allows")
        self._check_stop()
        self._take_up()
        result = self._trials.run(request)
        self.new_trials += 1
        outcome = self._note(result.outcome)
        self._progress.trial(outcome, len(self.outcomes), self._expected, self._remaining_s())
        if self._told is not None:
            self._told(outcome)
        if unsettled(outcome):
            self._warn_unsettled(outcome)
        if result.fault is not None:
            self._after_fault(result.fault)
        else:
            self._failures = 0
            self._count_raised(result.raised, outcome.reason)
        return outcome

    def _count_raised(self, raised: str, reason: str) -> None:
        """End the run where an objective raises the same again and again: more trials would raise it, too."""
        before, count = self._raised
        self._raised = (raised, count + 1 if raised == before else 1) if raised else ("", 0)
        if self._raised[1] >= _MOST_RAISED:
            raise ExperimentError(
                f"{_MOST_RAISED} trials failed one after the other in the same way; the last: {reason}",
                hint="everything recorded is kept; fix the objective before you resume the run",
            )

    def _warn_unsettled(self, outcome: TrialOutcome) -> None:
        """Journal every trial that did not settle; warn on the first one."""
        settle = outcome.settle
        if settle is None:
            return
        self._folder.journal.append(
            "settle-timeout",
            sync=False,
            index=outcome.index,
            after_s=settle.duration_s,
            channel=settle.channel,
        )
        if self._warned:
            return
        self._warned = True
        spread = "" if settle.spread is None else f": {settle.channel} still spreads by {settle.spread:.3g}"
        self._progress.note(
            f"warning: trial {outcome.index} was recorded although the bench had not come to rest in "
            f'{settle.duration_s:.0f} s{spread}; trial.settle.on_timeout = "reject" or "stop" would not accept that'
        )

    def _note(self, outcome: TrialOutcome) -> TrialOutcome:
        self.index += 1
        self.outcomes.append(outcome)
        if message := self._damage.take(outcome):
            self._progress.note(message)
        self._previous = outcome
        return outcome

    def _take_up(self) -> None:
        """Bring the bench to where the trial before left it, if that one did not run in this session."""
        previous = self._previous
        if (
            previous is not None
            and self._stored.get(previous.index) is not None
            and previous.checkpoint is not None
        ):
            self._trials.restore(previous.checkpoint)
        settle = self._experiment.trial.settle
        if settle is not None and needs_baseline(settle) and self._trials.baseline is None:
            self._progress.phase("baseline")
            self._trials.measure_baseline(settle)

    def _after_fault(self, fault: DeviceError) -> None:
        if isinstance(fault, LimitExceededError) or self._experiment.trial.on_fault == "stop":
            raise fault
        self._failures += 1
        if self._failures >= _MOST_FAILURES:
            raise DeviceError(
                fault.device,
                f"{_MOST_FAILURES} trials failed one after the other; the last: {fault.args[0]}",
                hint=fault.hint or "look at the bench, then labrun resume",
            ) from fault
        self._progress.note(f"{fault}")
        if fault.device in self._rig.devices:
            self._reopen(fault.device)

    def _reopen(self, device: str) -> None:
        """Reconnect a device; an unplugged one has some time to come back."""
        clock = self._bench.clock
        deadline_s = clock.now() + _COME_BACK_S
        while True:
            try:
                self._rig.reopen(device)
            except DeviceError:
                if clock.now() >= deadline_s:
                    raise
            else:
                return
            self._check_stop()
            clock.sleep(_TRY_AGAIN_S)

    def _reject_outliers(self, measurement: Measurement) -> None:
        objectives = self._experiment.objectives
        goal = self._experiment.goal
        default = goal[0] if goal is not None else next(iter(objectives), None)
        self._mark(find_outliers(measurement, self._experiment.trial.outliers, default))

    def _remaining_s(self) -> float | None:
        if self._expected is None or self.new_trials == 0:
            return None
        each_s = (self._stopwatch.now() - self._started_s) / self.new_trials
        return max(0.0, each_s * (self._expected - len(self.outcomes)))
