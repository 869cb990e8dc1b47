"""One trial: prepare, settle, tare, record, safe pose, and only then store."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from labrun.errors import DeviceError, ExperimentError, LabrunError
from labrun.experiment import Experiment, Settle, condition_text, scene_of
from labrun.runner.asking import Asking, AutoConfirm, Onlooker, Person
from labrun.runner.bench import Bench
from labrun.runner.damage import Damage
from labrun.runner.following import require_followed
from labrun.runner.measurement import ObjectiveError, ObjectiveEvaluation
from labrun.runner.motion import MotionMaker, TrialMotion
from labrun.runner.recording import Recorder, SampleCollector, TrialRecording, TrialRequest
from labrun.runner.settle import Settled, measure_baseline, settle
from labrun.runner.stillness import Bounds
from labrun.runner.tare import tare
from labrun.store import RunFolder, TrialOutcome, TrialWriter, in_bytes, json_ready

BASELINE_INDEX = 2**31 - 1
"""Stands for the baseline where device noise is derived from a trial's index."""

MOST_CHECKPOINT_BYTES = 1_000_000
"""A simulated bench remembers some seconds; one that remembers more has a list that grows."""
_POINT_BYTES = 100
"""Of a point of the trial's motion, which the bench may remember several times."""


@dataclass(frozen=True, slots=True)
class TrialResult:
    """A stored trial; the device's fault that ended it early, and what an objective's plugin raised, if any did."""

    outcome: TrialOutcome
    fault: DeviceError | None = None
    raised: str = ""


class _Draft:
    """What is known of a trial so far; enough to store it whenever it ends."""

    def __init__(self, request: TrialRequest, bench: Bench, writer: TrialWriter, discard_cycles: int) -> None:
        self.collector = SampleCollector(bench, writer)
        self.motion: TrialMotion | None = None
        self.settled = Settled(None, None)
        self.recording: TrialRecording | None = None
        self.recorded = False
        self.answers: Mapping[str, float] = {}
        self.outcome = TrialOutcome(
            index=request.index,
            condition=dict(request.condition),
            repeat=request.repeat,
            role=request.role,
            started_s=bench.clock.now(),
            attempt=request.attempt,
            discard_cycles=discard_cycles,
            mounting=request.mounting,
        )

    def know(self, **fields: Any) -> None:
        self.outcome = replace(self.outcome, **fields)


class TrialRunner:
    """Runs trials one at a time.

    Parameters
    ----------
    experiment, bench, folder
        What to do, on what, and where data goes.
    seed
        Each trial's device noise derives from it and the trial's index.
    recorder
        How a trial is recorded: its whole motion sent at once, unless something else is asked for.
    person, wait
        Who types results, where the file asks for some; and what waits a moment for them.

    Raises
    ------
    ExperimentError
        Results are asked for, and neither a person nor the scene could tell any.
    """

    def __init__(
        self,
        experiment: Experiment,
        bench: Bench,
        folder: RunFolder,
        motions: MotionMaker,
        *,
        seed: int,
        phase: Callable[[str], object],
        recorder: Recorder,
        person: Person,
        wait: Callable[[], object],
        may_correct: Callable[[int], bool],
        correct: Callable[[int, Mapping[str, float]], object],
    ) -> None:
        self._experiment = experiment
        self._table = experiment.trial
        self._bench = bench
        self._rig = bench.rig
        self._folder = folder
        self._seed = seed
        self._phase = phase
        self._recorder = recorder
        self._motions = motions
        self._evaluation = ObjectiveEvaluation(experiment)
        self._asking = self._made_asking(person, wait, may_correct, correct)
        self._damage = Damage(experiment.damage, experiment.by_hand)
        self._speed_rad_s = math.radians(self._table.move_speed_deg_s)
        self._safe_pose = {joint: math.radians(deg) for joint, deg in self._table.safe_pose_deg.items()}
        self.baseline: Bounds | None = None

    def _made_asking(
        self,
        person: Person,
        wait: Callable[[], object],
        may_correct: Callable[[int], bool],
        correct: Callable[[int, Mapping[str, float]], object],
    ) -> Asking:
        questions = self._evaluation.questions
        simulated = (
            Onlooker.of(self._rig.scene, self._bench.clock) if isinstance(person, AutoConfirm) else None
        )
        if questions and isinstance(person, AutoConfirm) and simulated is None:
            raise ExperimentError(
                f"{', '.join(questions)} would be typed by a person, and no scene answers in their place",
                hint="--dry-run with a scene that has a method answer(), the bench, or Python with person=...",
            )
        return Asking(questions, person, simulated, self._journal, wait, may_correct, correct)

    def run(self, request: TrialRequest) -> TrialResult:
        """Run and store one trial.

        Returns
        -------
        TrialResult
            With the fault, if a device's ended it: actuators are stopped, and what was recorded is stored as failed.

        Raises
        ------
        Interrupted, SettleError, StoreError
            The run ends: actuators are stopped first, then what was recorded is stored.
        """
        writer = self._folder.writer(request.index)
        draft = _Draft(request, self._bench, writer, self._table.discard_cycles)
        try:
            self._measure_until_asked_to_stop(request, draft, writer)
        except DeviceError as fault:
            self._stop(request.index, fault)
            fault.happened(f"in trial {request.index}", draft.outcome.started_s)
            if self._table.until is not None:  # its cycles are kept, and it goes on with them
                self._keep_unfinished(draft, writer, fault)
                raise
            draft.know(status="failed", reason=str(fault).splitlines()[0])
            return TrialResult(self._store(draft, writer), fault)
        except BaseException as error:
            self._stop(request.index, error)
            self._keep_unfinished(draft, writer, error)
            raise
        try:
            if draft.recorded:
                about = condition_text(request.condition, self._experiment.units, digits=4)
                draft.answers = self._asking.ask(request.index, f"trial {request.index + 1}, {about}")
            raised = self._evaluate(draft, writer)
        except BaseException as error:
            self._keep_unfinished(draft, writer, error)
            raise
        return TrialResult(self._store(draft, writer), raised=raised)

    def _measure_until_asked_to_stop(self, request: TrialRequest, draft: _Draft, writer: TrialWriter) -> None:
        """Measure; a device that complains because it was stopped on request has no fault."""
        try:
            self._measure(request, draft, writer)
        except DeviceError:
            self._bench.check_stop()
            raise

    def _measure(self, request: TrialRequest, draft: _Draft, writer: TrialWriter) -> None:
        """Do everything that moves or waits."""
        motion = draft.motion = self._motions.motion(request.condition)
        draft.know(duration_s=motion.duration_s, period_s=motion.period_s)
        self._rig.reseed(self._seed, request.index)
        self._rig.arm()
        self._bench.check_health()
        self._prepare(request, motion)
        self._phase("settle")
        draft.settled = settle(self._bench, self._table.settle, self.baseline)
        draft.know(settle=draft.settled.summary)
        if draft.settled.rejected:
            draft.know(status="rejected", reason=draft.settled.rejected)
        else:
            draft.know(tare=tare(self._bench, self._table.tare))
            self._record(request, motion, draft)
            self._require_well(draft, writer)
        self._come_to_safe_pose(request.index)
        self._bench.stop_sensors()
        self._rig.disarm()

    def _prepare(self, request: TrialRequest, motion: TrialMotion) -> None:
        self._phase("prepare")
        self._journal(
            "prepare",
            index=request.index,
            condition=dict(request.condition),
            repeat=request.repeat,
            role=request.role,
            attempt=request.attempt,
        )
        self._asking.look()
        if self._rig.scene is not None:
            self._rig.scene.arrange(request.condition)
            if request.mounting is not None and hasattr(self._rig.scene, "mount"):
                self._rig.scene.mount(request.mounting)
        for name, device in self._rig.arranging.items():
            with self._rig.calls(name, "arrange"):
                device.arrange(request.condition)
        self._bench.wait_for_arrangements()
        self._bench.start_sensors()
        first = dict(zip(motion.trajectory.joints, motion.trajectory.angle_rad[0], strict=True))
        self._bench.move(first, self._speed_rad_s)
        if motion.travel is not None:
            self._bench.travel_and_wait(
                motion.travel.device,
                motion.travel.from_m,
                motion.travel.return_speed_m_s,
                motion.travel.acceleration_m_s2,
            )

    def _record(self, request: TrialRequest, motion: TrialMotion, draft: _Draft) -> None:
        self._phase("record")
        summary = draft.settled.summary
        self._journal(
            "record",
            index=request.index,
            settled=None if summary is None else summary.reason,
            tare=draft.outcome.tare,
        )

        def on_start(start_s: float) -> None:
            draft.know(started_s=start_s)
            draft.recorded = True
            getattr(self._rig.scene, "begin", lambda _: None)(start_s)

        for device in self._rig.paced.values():
            device.restart_pacing()  # what moved it here does not count
        recording = TrialRecording(
            self._bench, motion, request, draft.outcome.tare, draft.collector, on_start
        )
        draft.recording = recording
        recording.move_speed_rad_s = self._speed_rad_s
        recording.remark = lambda text: self._journal("remark", index=request.index, text=text)
        try:
            self._recorder(recording)
        finally:
            draft.know(tare=dict(recording.tare), censored=recording.censored)
            if recording.duration_s is not None:
                draft.know(duration_s=recording.duration_s)
            sent = recording.command()
            if sent is not None:
                draft.motion = replace(motion, trajectory=sent)
            for name, device in self._rig.paced.items():
                self._journal("commands", index=request.index, device=name, **asdict(device.pacing()))

    def _require_well(self, draft: _Draft, writer: TrialWriter) -> None:
        """Make sure that no device restarted, lost its torque or left its command during the recording.

        Raises
        ------
        DeviceError
            One did: what was recorded is not what the trial was to show.
        """
        self._bench.check_health()
        motion, recording = draft.motion, draft.recording
        if (
            motion is None or recording is None or recording.fault
        ):  # stopped on purpose, before its motion was over
            return
        recorded = writer.signals(draft.outcome.started_s, draft.outcome.tare)
        until = self._table.until is not None
        require_followed(self._table.follow, self._rig, recorded, motion, periodic=until)

    def _come_to_safe_pose(self, index: int) -> None:
        if self._safe_pose:
            self._phase("safe pose")
            self._journal("safe-pose", index=index)
            self._bench.move(self._safe_pose, self._speed_rad_s)

    def _evaluate(self, draft: _Draft, writer: TrialWriter) -> str:
        """Compute the objectives; return the error of a plugin, if any."""
        outcome, motion, recording, raised = draft.outcome, draft.motion, draft.recording, ""
        if motion is None or recording is None or not draft.recorded:
            return raised
        try:
            objectives = recording.objectives
            if objectives is None:
                signals = writer.signals(outcome.started_s, outcome.tare)
                objectives = self._evaluation.evaluate(signals, motion, outcome.condition, draft.answers)
                draft.know(truncation=self._evaluation.truncation(signals, motion, outcome.condition))
                for text in self._evaluation.remarks(signals, motion, outcome.condition):
                    recording.remark(text)
            draft.know(objectives=dict(objectives))
        except ObjectiveError as error:
            draft.know(status="failed", reason=str(error).splitlines()[0])
            raised = error.raised
        fault = draft.collector.fault(self._table.max_lost_share) or recording.fault
        if fault:
            draft.know(status="rejected", reason=fault)
        return raised

    def _stop(self, index: int, error: BaseException) -> None:
        """Stop everything that moves, before anything else; then end the streams."""
        failures = self._rig.safe_stop()
        try:
            self._bench.stop_sensors()
        except Exception as also:  # a lost device cannot end its stream; the error that counts is on its way
            failures.append(str(also))
        self._rig.disarm()
        try:
            self._journal("stopped", index=index, cause=f"{type(error).__name__}: {error}", failures=failures)
        except LabrunError as also:  # a full disk, most likely, which is also why the run ends
            error.add_note(f"the stop could not be journalled: {also}")

    def _store(self, draft: _Draft, writer: TrialWriter) -> TrialOutcome:
        self._phase("store")
        if draft.recorded:
            draft.know(damage=self._damage.done_by(draft.outcome))
        draft.know(checkpoint=self.checkpoint())
        try:
            self._require_bounded_memory(draft)
        except ExperimentError as error:
            draft.know(checkpoint=None)
            self._keep_unfinished(draft, writer, error)
            raise
        outcome = self._finish(draft, writer)
        if draft.recording is not None:
            draft.recording.stored()
        return outcome

    def _finish(self, draft: _Draft, writer: TrialWriter) -> TrialOutcome:
        moved = draft.motion is not None and draft.motion.trajectory.joints
        command = draft.motion.trajectory if draft.motion is not None and moved else None
        try:
            writer.finish(draft.outcome, draft.settled.curve, command)
        except BaseException:
            writer.discard()
            raise
        return draft.outcome

    def _keep_unfinished(self, draft: _Draft, writer: TrialWriter, error: BaseException) -> None:
        """Store an interrupted trial without a checkpoint, so that it is run again."""
        if not draft.recorded:
            writer.discard()
            return
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        draft.know(status="failed", reason=f"cut short: {reason}")
        try:
            self._finish(draft, writer)
        except LabrunError as also:
            error.add_note(f"the unfinished trial could not be kept: {also}")

    def measure_baseline(self, rule: Settle) -> None:
        """Measure how still the undisturbed bench is: what "quiet" means for every settling of the run."""
        self._rig.reseed(self._seed, BASELINE_INDEX)
        try:
            self.baseline = measure_baseline(self._bench, rule)
        except BaseException as error:
            self._stop(-1, error)
            raise
        self._journal("baseline", spread=self.baseline.spread, drift=self.baseline.drift)

    def checkpoint(self) -> str:
        """Return the state that a resumed run needs, as JSON."""
        memory = self._bench.snapshot()
        if self.baseline is not None:
            memory["baseline"] = {"spread": list(self.baseline.spread), "drift": list(self.baseline.drift)}
        return json.dumps(memory, default=json_ready)

    def _require_bounded_memory(self, draft: _Draft) -> None:
        """Make sure that the bench remembers no more than its last moments and the motion of this trial.

        Raises
        ------
        ExperimentError
            The scene, or a device, keeps all of its past.
        """
        points = 0 if draft.motion is None else draft.motion.trajectory.angle_rad.size
        most = MOST_CHECKPOINT_BYTES + _POINT_BYTES * points
        if draft.outcome.status == "failed" or len(draft.outcome.checkpoint or "") <= most:
            return
        memory = json.loads(draft.outcome.checkpoint or "{}")
        parts = {f"device {name}": part for name, part in memory.get("devices", {}).items()}
        parts[f"the scene {scene_of(self._experiment.rig).plugin}"] = memory.get("scene")
        sizes = {name: len(json.dumps(part)) for name, part in parts.items()}
        name = max(sizes, key=lambda part: sizes[part])
        raise ExperimentError(
            f"{name} returned a snapshot of {in_bytes(sizes[name])}; at most {in_bytes(most)} are kept with this trial",
            hint="a list in it grows with every trial: let drive() drop what is over, as on the page "
            '"A scene of your own"',
        )

    def restore(self, checkpoint: str) -> None:
        """Go on from a checkpoint, see `Bench.restore`."""
        memory = json.loads(checkpoint)
        self._bench.restore(memory)
        baseline = memory.get("baseline")
        if baseline is not None:
            self.baseline = Bounds(tuple(baseline["spread"]), tuple(baseline["drift"]))

    def _journal(self, event: str, **fields: Any) -> None:
        self._folder.journal.append(event, clock_s=self._bench.clock.now(), **fields)
