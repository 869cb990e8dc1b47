"""Records trials of a compiled loop: in simulated time, or in a thread of its own on a bench."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from labrun.arrays import FloatArray
from labrun.control.closed_loop import ClosedLoopRecorder, Timing
from labrun.control.compiled.law import Channels, law_of, refusal, straight_gait, wiring_of
from labrun.control.compiled.stepping import (
    CLAMPED,
    FULL,
    GOOD,
    LOST_ORIENTATION,
    NOT_FINITE,
    STOPPED,
    UNSENT,
    UNSOLVED,
    UNWATCHED,
    Law,
)
from labrun.control.feedbacks import COMPONENTS
from labrun.control.loop import Loop
from labrun.control.protocol import Condition
from labrun.devices import Samples, Trajectory
from labrun.devices.compiled import BEYOND, GONE, HALTED, TOO_LATE
from labrun.errors import DeviceError, ExperimentError, SpecError
from labrun.gaits import steering_of
from labrun.runner import LEAD_S, TAIL_S, Bench, Rig, TrialRecording
from labrun.spec import LOOP_DEVICE, Experiment, condition_text

if TYPE_CHECKING:
    from labrun.control.compiled.real_time import RealTimeLoop

_ON_TIME = 1e-9
_SLOWEST = 3.0
"""Periods of the slowest sensor before the first step: it needs a sample to compare."""
_MORE = 5
_LOOK_S = 0.05
_HAND_OVER_S = 0.02
_REFERENCES = 200
"""References computed between two looks at the bench."""
_BUSY = "this computer was too busy: close other programs; the right to real-time priority helps"
_ENDED = {
    STOPPED: ("it was stopped", "labrun resume goes on"),
    FULL: ("nobody took its records for 2 s", _BUSY),
    UNWATCHED: ("the runner did not look at the bench for 0.1 s, so the loop sent nothing more", _BUSY),
    UNSENT + HALTED: ("its joints were stopped", "labrun resume goes on"),
    UNSENT + BEYOND: ("a set-point leaves a limit of the joints; it was not sent", "look at the bench first"),
    UNSENT + TOO_LATE: (
        "the joints heard nothing for longer than their watchdog waits, and have stopped",
        _BUSY,
    ),
    UNSENT + GONE: ("the port of the joints is gone", "check its cable and power; then labrun resume"),
}
"""Why a loop in real time ended, and what to do."""


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

    def require_makeable(self, conditions: Sequence[Condition]) -> None:
        """Raise SpecError unless every condition gives a reference and a controller that have a compiled form."""
        super().require_makeable(conditions)
        for condition in conditions:
            try:
                self._require_devices()
                loop = self._made(condition)
                law = self._law(condition, loop, {})
                if not self._simulated:
                    self._real(law, loop, np.array([loop.reference(0.0)])).compile()
            except SpecError as error:
                raise SpecError(f"{condition_text(condition)}: {error}") from error

    def __call__(self, recording: TrialRecording) -> None:
        """Record one trial."""
        loop = self._made(recording.condition)
        law = self._law(recording.condition, loop, recording.tare)
        if self._simulated:
            self._simulate(recording, loop, law)
        else:
            self._in_real_time(recording, loop, law)
        bounded = int(law.wiring.counts[CLAMPED])
        if bounded:
            recording.remark(
                f"loop {loop.name}: a limit of the joints bounded the command at {bounded} steps"
            )
        unsolved = int(law.affine.counts[UNSOLVED])
        if unsolved:
            recording.remark(
                f"loop {loop.name}: after {unsolved} samples the least squares had no solution, and the weights stayed "
                "as they were: too little moved for so small a ridge"
            )

    def _require_devices(self) -> None:
        if self._simulated:
            from labrun.control.compiled.dry_run import require_compiled

            require_compiled(self._rig, self._gait.joints, 1.0 / self._track.rate_hz)
        else:
            from labrun.control.compiled.real_time import require_real_time

            require_real_time(self._rig, self._gait.joints)

    def _places(self) -> Mapping[str, int]:
        if self._simulated:
            from labrun.control.compiled.dry_run import compiled_places

            return compiled_places(self._rig)
        from labrun.control.compiled.real_time import channel_places

        return channel_places(self._rig)

    def _made(self, condition: Condition) -> Loop:
        (loop,) = self._loops(condition, 1.0 / self._track.rate_hz, None)
        return loop

    def _law(self, condition: Condition, loop: Loop, tare: Mapping[str, float]) -> Law:
        track, period_s = self._track, 1.0 / self._track.rate_hz
        table = track.loops[loop.name]
        context = self._context(loop.name, table, period_s)
        channels = Channels(tuple(self._rig.sensors), self._places())
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
            straight_gait(steering, list(track.steered), (context.low, context.high)), limits,
        )  # fmt: skip
        return law_of(loop.controller, context, wiring, channels)

    def _simulate(self, recording: TrialRecording, loop: Loop, law: Law) -> None:
        from labrun.control.compiled.dry_run import CompiledDryRun

        bench, motion, period_s = recording.bench, recording.motion, 1.0 / self._track.rate_hz
        run = CompiledDryRun(self._rig, law, motion.trajectory.joints, period_s)
        steps = self._steps(motion.duration_s)
        drives = np.full(len(loop.variables), self._track.loops[loop.name].start)
        lead_s = max([LEAD_S, *(_SLOWEST / one.rate_hz for one in self._rig.sensors.values())])
        start_s = run.begin(lead_s, steps, len(self._places()), drives)
        sent: list[tuple[FloatArray, FloatArray]] = []
        recording.begin(start_s, lambda: _joined(sent, motion.trajectory, start_s))
        run.take_over()
        end_s = start_s + motion.duration_s + TAIL_S
        taken = 0
        while run.now_s < end_s:
            result = run.block(end_s, loop.reference)
            sent.append((result.time_s, result.goals))
            bench.clock.sleep(run.now_s - bench.clock.now())
            recording.collector.take(bench.look())
            records = result.records
            none = np.zeros(len(records))
            timing = np.column_stack([records[:, 1], np.full(len(records), np.nan), none, none])
            self._keep(recording, loop, start_s + records[:, 0], records[:, 2:], timing)
            taken += len(records)
            if result.status != GOOD:
                raise _failure(loop, result.status, taken * period_s)

    def _in_real_time(self, recording: TrialRecording, loop: Loop, law: Law) -> None:
        bench, motion, clock = recording.bench, recording.motion, recording.bench.clock
        run = self._real(law, loop, self._references(loop, bench, self._steps(motion.duration_s)))
        run.show()
        timing = Timing()
        sent: list[tuple[FloatArray, FloatArray]] = []

        def handle(blocks: Mapping[str, Samples]) -> None:
            recording.collector.take(blocks)
            self._keep_real(recording, loop, start_s, run.drain(), timing, sent)

        try:
            while not run.seen():  # a device that never answers is found silent by the bench
                bench.watch(clock.now() + _LOOK_S)
            start_s = clock.now() + LEAD_S
            recording.begin(start_s, lambda: _joined(sent, motion.trajectory, start_s))
            bench.watch(start_s - _HAND_OVER_S, handle)
            recording.start_travel()
            run.begin(start_s)
            while run.running:
                bench.watch(clock.now() + clock.poll_s, handle)
            handle(bench.look())
        except DeviceError as error:
            if run.status == UNWATCHED:  # a device that was asked nothing since then is silent
                raise self._ended(loop, run, timing) from error
            raise
        finally:
            run.end()
        run.check()
        timing.skipped += run.skipped_last
        if run.status != GOOD:
            raise self._ended(loop, run, timing)
        bench.watch(start_s + motion.duration_s + TAIL_S, handle)
        recording.fault = timing.fault(self._track.max_missed_share, self._track.rate_hz)

    def _ended(self, loop: Loop, run: "RealTimeLoop", timing: Timing) -> ExperimentError:
        taken = timing.steps + timing.skipped + len(run.drain())
        return _failure(loop, run.status, taken / self._track.rate_hz)

    def _real(self, law: Law, loop: Loop, references: FloatArray) -> "RealTimeLoop":
        from labrun.control.compiled.real_time import RealTimeLoop

        drives = np.full(len(loop.variables), float(self._track.loops[loop.name].start))
        angles = law.wiring.gait[:, :-1] @ drives + law.wiring.gait[:, -1]
        return RealTimeLoop(
            self._rig, law, references, self._gait.joints, drives, angles, 1.0 / self._track.rate_hz
        )

    def _references(self, loop: Loop, bench: Bench, steps: int) -> FloatArray:
        """Return the reference at every step, (steps, components); the bench is looked after meanwhile."""
        period_s = 1.0 / self._track.rate_hz
        found = []
        for number in range(steps):
            found.append(loop.reference(number * period_s))
            if number % _REFERENCES == 0:
                bench.look()
        return np.array(found, dtype=float)

    def _keep_real(
        self, recording: TrialRecording, loop: Loop, start_s: float, records: FloatArray, timing: Timing,
        sent: list[tuple[FloatArray, FloatArray]],
    ) -> None:  # fmt: skip
        from labrun.control.compiled.real_time import MORE

        if not len(records):
            return
        joints = len(self._gait.joints)
        timing.steps += len(records)
        timing.missed += int(records[:, 4].sum())
        skipped = int(records[:, 5].sum())
        timing.skipped += skipped
        time_s = start_s + records[:, 0]
        sent.append((time_s, records[:, MORE : MORE + joints]))
        self._keep(recording, loop, time_s, records[:, MORE + joints :], records[:, 1:5], skipped)

    def _steps(self, duration_s: float) -> int:
        return math.ceil(duration_s * self._track.rate_hz * (1 - _ON_TIME))

    def _keep(
        self, recording: TrialRecording, loop: Loop, time_s: FloatArray, numbers: FloatArray,
        timing: FloatArray, skipped: int = 0,
    ) -> None:  # fmt: skip
        """Store what steps recorded: their own numbers, latency, lateness, and whether they missed their time."""
        if not len(time_s):
            return
        more = len(self._track.loops[loop.name].shape.more)
        last = numbers.shape[1] - (_MORE - more)
        values = np.column_stack([numbers[:, :last], timing])
        recording.collector.writer.append(
            LOOP_DEVICE, self.channels, self._track.rate_hz, Samples(time_s, time_s, values, lost=skipped)
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


def _failure(loop: Loop, status: int | None, time_s: float) -> ExperimentError:
    if status == LOST_ORIENTATION:
        body = loop.channels[0].removesuffix(f"_{COMPONENTS[0]}")
        return ExperimentError(
            f"loop {loop.name}: the tracker lost the body {body} at {time_s:.3f} s",
            hint="let it be seen again, then labrun resume",
        )
    if status is not None and NOT_FINITE <= status < STOPPED:
        variable = loop.variables[status - NOT_FINITE]
        return ExperimentError(
            f"loop {loop.name}: controller {loop.in_charge} asks for {variable} = no finite number at {time_s:.3f} s",
            hint="look at its gains or weights, and at the feedback recorded so far",
        )
    why, hint = _ENDED.get(status or 0, (f"it ended ({status})", "labrun resume goes on"))
    return ExperimentError(f"loop {loop.name}, at {time_s:.3f} s: {why}", hint=hint)
