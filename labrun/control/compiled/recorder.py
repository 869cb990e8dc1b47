"""Records trials of a compiled loop: in simulated time, or in a process of its own on a bench."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.control.closed_loop import ClosedLoopRecorder
from labrun.control.compiled.law import Channels, law_of, refusal, straight_gait, wiring_of
from labrun.control.compiled.stepping import CLAMPED, GOOD, LOST_ORIENTATION, Law
from labrun.control.loop import Loop
from labrun.control.protocol import Condition
from labrun.devices import Samples, Trajectory
from labrun.errors import ExperimentError, SpecError
from labrun.gaits import steering_of
from labrun.runner import LEAD_S, TAIL_S, Rig, TrialRecording
from labrun.spec import LOOP_DEVICE, Experiment, condition_text

_ON_TIME = 1e-9
_SLOWEST = 3.0
"""Periods of the slowest sensor before the first step: it needs a sample to compare."""
_MORE = 5


def loop_recorder(experiment: Experiment, rig: Rig) -> ClosedLoopRecorder:
    """Return what records trials with the loops of an experiment closed, compiled where the file asks for it."""
    compiled = experiment.track is not None and experiment.track.compiled
    return CompiledLoopRecorder(experiment, rig) if compiled else ClosedLoopRecorder(experiment, rig)


class CompiledLoopRecorder(ClosedLoopRecorder):
    """As `ClosedLoopRecorder`, for one loop whose steps are compiled.

    Parameters
    ----------
    experiment, rig
        As of `ClosedLoopRecorder`.

    Raises
    ------
    SpecError
        Several loops, or what has no compiled form.
    """

    def __init__(self, experiment: Experiment, rig: Rig) -> None:
        super().__init__(experiment, rig)
        self._rig = rig
        if len(self._track.loops) != 1:
            raise refusal(f"{len(self._track.loops)} loops side by side")
        if not self._simulated:
            raise refusal("real time")

    def require_makeable(self, conditions: Sequence[Condition]) -> None:
        """Raise SpecError unless every condition gives a reference and a controller that have a compiled form."""
        super().require_makeable(conditions)
        from labrun.control.compiled.dry_run import require_compiled

        for condition in conditions:
            try:
                require_compiled(self._rig, self._gait.joints, 1.0 / self._track.rate_hz)
                self._law(condition, self._made(condition), {})
            except SpecError as error:
                raise SpecError(f"{condition_text(condition)}: {error}") from error

    def __call__(self, recording: TrialRecording) -> None:
        """Record one trial."""
        loop = self._made(recording.condition)
        law = self._law(recording.condition, loop, recording.tare)
        self._simulate(recording, loop, law)
        bounded = int(law.wiring.counts[CLAMPED])
        if bounded:
            recording.remark(
                f"loop {loop.name}: a limit of the joints bounded the command at {bounded} steps"
            )

    def _made(self, condition: Condition) -> Loop:
        (loop,) = self._loops(condition, 1.0 / self._track.rate_hz, None)
        return loop

    def _law(self, condition: Condition, loop: Loop, tare: Mapping[str, float]) -> Law:
        from labrun.control.compiled.dry_run import compiled_places

        track, period_s = self._track, 1.0 / self._track.rate_hz
        table = track.loops[loop.name]
        context = self._context(loop.name, table, period_s)
        channels = Channels(tuple(self._rig.sensors), compiled_places(self._rig))
        gait = self._experiment.gait
        steering = steering_of(self._gait, gait.plugin, condition, list(track.steered))
        limits = [
            self._rig.limits[name]
            for joint in self._gait.joints
            for name, actuator in self._rig.actuators.items()
            if joint in getattr(actuator, "joints", ())
        ]
        wiring = wiring_of(
            loop.feedbacks, context, channels, tare,
            math.inf if table.slew_per_s is None else table.slew_per_s * period_s,
            straight_gait(steering, list(track.steered)), limits,
        )  # fmt: skip
        return law_of(loop.controller, context, wiring, channels)

    def _simulate(self, recording: TrialRecording, loop: Loop, law: Law) -> None:
        from labrun.control.compiled.dry_run import CompiledDryRun, compiled_places

        bench, motion, period_s = recording.bench, recording.motion, 1.0 / self._track.rate_hz
        run = CompiledDryRun(self._rig, law, motion.trajectory.joints, period_s)
        steps = math.ceil(motion.duration_s / period_s * (1 - _ON_TIME))
        drives = np.full(len(loop.variables), self._track.loops[loop.name].start)
        lead_s = max([LEAD_S, *(_SLOWEST / one.rate_hz for one in self._rig.sensors.values())])
        start_s = run.begin(lead_s, steps, len(compiled_places(self._rig)), drives)
        sent: list[tuple[FloatArray, FloatArray]] = []
        recording.begin(start_s, lambda: _joined(sent, motion.trajectory, start_s))
        run.take_over()
        end_s = start_s + motion.duration_s + TAIL_S
        while run.now_s < end_s:
            result = run.block(end_s, loop.reference)
            sent.append((result.time_s, result.goals))
            bench.clock.sleep(run.now_s - bench.clock.now())
            recording.collector.take(bench.look())
            self._keep(recording, loop, start_s, result.records)
            if result.status != GOOD:
                raise _failure(loop, result.status, float(len(result.records)) * period_s)

    def _keep(self, recording: TrialRecording, loop: Loop, start_s: float, records: FloatArray) -> None:
        if not len(records):
            return
        more = len(self._track.loops[loop.name].shape.more)
        time_s = start_s + records[:, 0]
        last = records.shape[1] - (_MORE - more)
        timing = np.column_stack([records[:, 1], np.zeros((len(records), 2))])
        values = np.column_stack([records[:, 2:last], timing])
        recording.collector.writer.append(
            LOOP_DEVICE, self.channels, self._track.rate_hz, Samples(time_s, time_s, values)
        )


def _joined(
    sent: Sequence[tuple[FloatArray, FloatArray]], planned: Trajectory, start_s: float
) -> Trajectory | None:
    """Return what the joints were told from the start on; None if nothing was."""
    if not sent:
        return None
    time_s = np.concatenate([times for times, _ in sent]) - start_s
    angle_rad = np.concatenate([angles for _, angles in sent])
    from_start = time_s > -_ON_TIME
    if not from_start.any():
        return None
    return Trajectory(
        planned.joints, np.maximum(time_s[from_start], 0.0), angle_rad[from_start], planned.period_s
    )


def _failure(loop: Loop, status: int, time_s: float) -> ExperimentError:
    if status == LOST_ORIENTATION:
        return ExperimentError(
            f"loop {loop.name}: the tracker gives no orientation; it lost the body",
            hint="let it be seen again, then labrun resume",
        )
    return ExperimentError(
        f"loop {loop.name}: its controller asks for no finite number at {time_s:.3f} s",
        hint="look at its gains or weights, and at the feedback recorded so far",
    )
