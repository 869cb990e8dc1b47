"""The closed-loop way to record a trial: look, compute, command, once a step; the gait is steered piece by piece."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from labrun.control.history import History
from labrun.control.loop import Loop
from labrun.control.making import make_feedback, watched_by
from labrun.control.protocol import Condition, Feedback, LoopContext
from labrun.devices import Channel, FloatArray, Samples, Trajectory
from labrun.errors import SpecError
from labrun.experiment import LOOP_DEVICE, TIMING_CHANNELS, Experiment, LoopTable, Track, condition_text
from labrun.gaits import Steering, make_gait, steering_of
from labrun.runner import LEAD_S, TAIL_S, Handle, Rig, SimulatedClock, TrialRecording
from labrun.signals import TIMES

_SAME_S = 1e-6
"""Two points of a command are further apart than this."""


class Pieces:
    """Cuts a steered gait into pieces, one a step of the loop.

    Within a step's period the steered variables go straight from where they stand to where the step sets them. A piece
    is twice as long as a period: for the second half the gait goes on with its variables held, so that one step that
    comes late goes unnoticed; after that the actuator stands still at the piece's last point, which is the safe state
    of every actuator. When the next command comes at last, the gait goes on from where it stopped: the angles that are
    commanded never jump.

    Parameters
    ----------
    steering
        Of the gait.
    start
        Values of the steered variables at the beginning.
    slew_per_s
        How fast each may change; those that are not named may go anywhere within a period.
    rate_hz
        Points of a piece come no less often.
    duration_s
        Of the recording: no piece goes on after it.
    cycle_s
        Of the gait.
    """

    def __init__(
        self,
        steering: Steering,
        joints: tuple[str, ...],
        start: Mapping[str, float],
        *,
        slew_per_s: Mapping[str, float],
        period_s: float,
        rate_hz: float,
        duration_s: float,
        cycle_s: float | None,
    ) -> None:
        self._steering = steering
        self._joints = joints
        self._period_s = period_s
        self._rate_hz = rate_hz
        self._duration_s = duration_s
        self._cycle_s = cycle_s
        self._most = {name: rate * period_s for name, rate in slew_per_s.items()}
        self._from = dict(start)
        self._to = dict(start)
        self._gait_s = 0.0
        self._start_s = 0.0
        self._grid = self._points(2.0 * period_s)
        self._ramp = np.minimum(self._grid / period_s, 1.0)
        self._sent: list[tuple[float, FloatArray, FloatArray]] = []
        self._made: tuple[float, FloatArray, FloatArray] | None = None

    def first(self) -> Trajectory:
        """Return the first piece, from time 0."""
        return self._piece(None)

    def drives(self, time_s: float) -> dict[str, float]:
        """Return where the steered variables stand at a time of the trial."""
        share = min(max((time_s - self._start_s) / self._period_s, 0.0), 1.0)
        return {name: value + share * (self._to[name] - value) for name, value in self._from.items()}

    def next(self, time_s: float, goals: Mapping[str, float]) -> Trajectory:
        """Return the piece that begins at a time of the trial and takes the variables towards their goals."""
        before_s, times, angles = self._sent[-1]
        passed_s = time_s - before_s
        here = np.array([np.interp(passed_s, times, column) for column in angles.T])
        self._from = self.drives(time_s)
        self._to = {name: self._within_slew(name, goals[name]) for name in self._from}
        self._gait_s += min(passed_s, float(times[-1]))
        self._start_s = time_s
        return self._piece(here)

    @property
    def goals(self) -> Mapping[str, float]:
        """Values that the variables reach one period after the start of the latest piece."""
        return self._to

    def _within_slew(self, name: str, goal: float) -> float:
        """Bound a goal by the slew rate from where the variable stands now, later than when the step began."""
        most = self._most.get(name, math.inf)
        return min(max(goal, self._from[name] - most), self._from[name] + most)

    def sent(self) -> None:
        """Take note that the latest piece has gone out: a piece that is refused is none that was commanded."""
        if self._made is not None:
            self._sent.append(self._made)
            self._made = None

    def command(self) -> Trajectory | None:
        """Return everything that was sent, each piece until the next one took its place; None if nothing was."""
        if not self._sent:
            return None
        ends = [start_s for start_s, _, _ in self._sent[1:]]
        parts = []
        for (start_s, times, angles), end_s in zip(self._sent, [*ends, math.inf], strict=True):
            kept = times < end_s - start_s - _SAME_S
            parts.append((start_s + times[kept], angles[kept]))
        time_s, angle_rad = (np.concatenate(column) for column in zip(*parts, strict=True))
        return Trajectory(self._joints, time_s, angle_rad, self._cycle_s)

    def _piece(self, here: FloatArray | None) -> Trajectory:
        left_s = self._duration_s - self._start_s
        grid, ramp = self._grid, self._ramp
        if left_s < grid[-1]:
            grid = self._points(max(left_s, 10 * _SAME_S))
            ramp = np.minimum(grid / self._period_s, 1.0)
        values = {name: value + ramp * (self._to[name] - value) for name, value in self._from.items()}
        angle_rad = self._steering(self._gait_s + grid, values)
        if here is not None:
            angle_rad[0] = here
        self._made = (self._start_s, grid, angle_rad)
        return Trajectory(self._joints, grid, angle_rad, self._cycle_s)

    def _points(self, length_s: float) -> FloatArray:
        steps = max(1, math.ceil(length_s * self._rate_hz * (1 - 1e-9)))
        return np.linspace(0.0, length_s, steps + 1)


def channels_of(
    experiment: Experiment, loops: Mapping[str, LoopTable], feedbacks: Mapping[str, Sequence[Feedback]]
) -> tuple[Channel, ...]:
    """Return the channels of the loops' stream: those of each loop, and the timing of the steps."""
    channels = []
    for name, table in loops.items():
        shape = table.shape
        of_feedback = [feedback.unit for feedback in feedbacks[name]]
        if len(of_feedback) == 1:  # of a vector, too
            of_feedback *= len(shape.components)
        of_drives = [experiment.units.get(variable, "") for variable in table.drives]
        units = [*3 * of_feedback, *2 * of_drives, *shape.more.values()]
        channels += [Channel(c, unit or "1") for c, unit in zip(shape.channels(name), units, strict=True)]
    return (
        *channels,
        *(Channel(name, unit) for name, unit in zip(TIMING_CHANNELS, ("s", "s", "s", "1"), strict=True)),
    )


_LOOK_S = 0.05
_ON_TIME = 1e-9
"""Share of a period by which rounding may make a step look late."""


@dataclass
class Timing:
    """How well the steps of a trial kept their time."""

    steps: int = 0
    missed: int = 0
    skipped: int = 0

    def fault(self, most_share: float, rate_hz: float) -> str:
        """Return why the trial cannot be used; empty if it can."""
        due, late = self.steps + self.skipped, self.missed + self.skipped
        if due == 0 or late <= most_share * due:
            return ""
        return (
            f"loop: {late} of {due} steps came too late for {rate_hz:g} Hz ({100 * late / due:.2g} %, "
            f"{100 * most_share:.2g} % is allowed): lower track.rate_hz, or make feedback and controller quicker"
        )


@dataclass
class _Clockwork:
    """The schedule of the steps of one trial, with late and skipped steps."""

    start_s: float
    period_s: float
    duration_s: float
    timing: Timing = field(default_factory=Timing)
    number: int = 0

    @property
    def _steps(self) -> int:
        return math.ceil(self.duration_s / self.period_s * (1 - _ON_TIME))

    @property
    def due_s(self) -> float | None:
        """When the next step is due by the run's clock; None after the last."""
        return None if self.number >= self._steps else self.start_s + self.number * self.period_s

    def begin(self, now_s: float) -> tuple[float, int]:
        """Begin the newest step that is due; return how late it is, s, and how many before it are skipped."""
        newest = min(int((now_s - self.start_s) / self.period_s + _ON_TIME), self._steps)
        skipped = max(0, newest - self.number)
        self.number += skipped
        late_s = max(0.0, now_s - self.start_s - self.number * self.period_s)
        self.timing.skipped += skipped
        return late_s, skipped

    def end(self, sent_s: float) -> bool:
        """End the step; tell whether its command was sent after the next step was due."""
        self.number += 1
        missed = sent_s > self.start_s + (self.number + _ON_TIME) * self.period_s
        self.timing.steps += 1
        self.timing.missed += missed
        return missed


class ClosedLoopRecorder:
    """Records trials with the loops of an experiment closed. Give it to a session as its `recorder`.

    At each step: wait until it is due, look at everything as always, compute feedback, reference and output, bound
    the output by range and slew rate, send the next piece of the motion (checked against the limits once more), record.
    A step that is late is taken as soon as can be, and recorded as late; steps that fell due meanwhile are skipped and
    counted, never caught up in a burst.

    Parameters
    ----------
    experiment
        Of kind "track".
    rig
        Its sensors say in which units the feedbacks come.

    Raises
    ------
    SpecError
        No table [track], or a feedback whose keys do not hold.
    """

    def __init__(self, experiment: Experiment, rig: Rig) -> None:
        if experiment.track is None:
            raise SpecError("the experiment has no loop to close", hint="a closed loop needs a table [track]")
        self._experiment = experiment
        self._track: Track = experiment.track
        self._columns = {
            f"{name}.{channel.name}": column
            for name, sensor in rig.sensors.items()
            for column, channel in enumerate(sensor.channels)
        }
        units = {f"{name}.{c.name}": c.unit for name, sensor in rig.sensors.items() for c in sensor.channels}
        self._feedbacks: dict[str, list[Feedback]] = {
            name: [make_feedback(name, feedback, units) for feedback in table.feedbacks]
            for name, table in self._track.loops.items()
        }
        self._simulated = isinstance(rig.clock, SimulatedClock)
        for name, feedbacks in self._feedbacks.items():
            missing = [c for feedback in feedbacks for c in feedback.channels if c not in self._columns]
            if missing:
                raise SpecError(f"feedback of loop {name}: the rig measures no {', '.join(missing)}")
        self.channels: tuple[Channel, ...] = channels_of(experiment, self._track.loops, self._feedbacks)
        """What the loops record, under the device name "loop"."""
        self._gait = make_gait(experiment.gait)

    @property
    def columns_hz(self) -> float:
        """Values that the loops record a second: their channels with times, and the command with its time."""
        columns = len(self.channels) + len(TIMES) + len(self._experiment.gait.joints) + 1
        return columns * self._track.rate_hz

    def require_makeable(self, conditions: Sequence[Condition]) -> None:
        """Raise SpecError unless every condition gives a reference and a controller to each loop."""
        for condition in conditions:
            try:
                self._loops(condition, 1.0 / self._track.rate_hz, None)
            except SpecError as error:
                raise SpecError(f"{condition_text(condition)}: {error}") from error

    def __call__(self, recording: TrialRecording) -> None:
        """Record one trial."""
        motion = recording.motion
        period_s = 1.0 / self._track.rate_hz
        loops = self._loops(recording.condition, period_s, motion.period_s)
        pieces = Pieces(
            steering_of(
                self._gait, self._experiment.gait.plugin, recording.condition, list(self._track.steered)
            ),
            motion.trajectory.joints,
            {name: table.start for name, table in self._track.steered.items()},
            slew_per_s={
                name: table.slew_per_s
                for name, table in self._track.steered.items()
                if table.slew_per_s is not None
            },
            period_s=period_s,
            rate_hz=self._experiment.gait.command_rate_hz,
            duration_s=motion.duration_s,
            cycle_s=motion.period_s,
        )
        try:
            for loop in loops:
                loop.begin()
            bench = recording.bench
            while not all(loop.ready() for loop in loops):
                bench.watch(bench.clock.now() + _LOOK_S)
            self._closed(recording, loops, pieces, period_s)
        finally:
            for loop in loops:
                loop.end()
        for loop in loops:
            for remark in loop.remarks():
                recording.remark(remark)

    def _closed(self, recording: TrialRecording, loops: list[Loop], pieces: Pieces, period_s: float) -> None:
        bench, motion, clock = recording.bench, recording.motion, recording.bench.clock
        start_s = clock.now() + LEAD_S
        history = self._history(recording.tare, start_s, motion.period_s)
        bench.follow(pieces.first(), start_s)
        pieces.sent()
        recording.begin(start_s, pieces.command)

        def handle(blocks: Mapping[str, Samples]) -> None:
            recording.collector.take(blocks)
            history.take(blocks)

        bench.watch(start_s, handle)
        recording.start_travel()
        while not history.complete:  # a device that never answers is found silent by the bench
            bench.watch(clock.now() + min(clock.poll_s, period_s), handle)
        self._run(recording, _Clockwork(start_s, period_s, motion.duration_s), loops, pieces, history, handle)
        bench.watch(start_s + motion.duration_s + TAIL_S, handle)

    def _run(
        self,
        recording: TrialRecording,
        clockwork: _Clockwork,
        loops: list[Loop],
        pieces: Pieces,
        history: History,
        handle: Handle,
    ) -> None:
        bench, clock, start_s = recording.bench, recording.bench.clock, clockwork.start_s
        before_s, heard_before_s = -clockwork.period_s, -math.inf
        while (due_s := clockwork.due_s) is not None:
            if due_s > clock.now():
                bench.watch(due_s, handle)
            else:
                handle(bench.look())
            now_s = clock.now()
            late_s, skipped = clockwork.begin(now_s)
            if clockwork.due_s is None:  # the recording is over
                self._record(recording, replace(Samples.empty(len(self.channels)), lost=skipped))
                break
            time_s = now_s - start_s
            drives = pieces.drives(time_s)
            records = [loop.step(time_s, time_s - before_s, drives, history) for loop in loops]
            before_s = time_s
            begin_s = clock.now()
            goals = {
                variable: value
                for loop, item in zip(loops, records, strict=True)
                for variable, value in zip(loop.variables, item.drive, strict=True)
            }
            bench.follow(pieces.next(begin_s - start_s, goals), begin_s)
            pieces.sent()
            sent_s = clock.now()
            records = [
                replace(item, drive=tuple([pieces.goals[variable] for variable in loop.variables]))
                for loop, item in zip(loops, records, strict=True)
            ]
            newest_s = start_s + min(history.newest_s(loop.channels) for loop in loops)
            heard_s = max(history.heard_s(loop.channels) for loop in loops)
            reaction_s = sent_s - heard_s if heard_s > heard_before_s else math.nan
            heard_before_s = heard_s
            missed = clockwork.end(sent_s)
            of_loops = chain.from_iterable(item.row for item in records)
            row = np.array([[*of_loops, sent_s - newest_s, reaction_s, late_s, float(missed)]])
            at = np.array([now_s])
            self._record(recording, Samples(at, at, row, lost=skipped))
        recording.fault = clockwork.timing.fault(self._track.max_missed_share, self._track.rate_hz)

    def _record(self, recording: TrialRecording, step: Samples) -> None:
        recording.collector.writer.append(LOOP_DEVICE, self.channels, self._track.rate_hz, step)

    def _loops(self, condition: Condition, period_s: float, cycle_s: float | None) -> list[Loop]:
        return [
            Loop(name, table, self._feedbacks[name], condition, self._context(name, table, period_s), cycle_s)
            for name, table in self._track.loops.items()
        ]

    def _context(self, name: str, table: LoopTable, period_s: float) -> LoopContext:
        low, high = (float(bound) for bound in table.range)
        scene = self._experiment.rig.scene
        return LoopContext(
            period_s,
            low,
            high,
            table.start,
            components=table.shape.components,
            unit=self._feedbacks[name][0].unit,
            drives={variable: self._experiment.units.get(variable, "") for variable in table.drives},
            rig="" if scene is None else scene.plugin,
            simulated=self._simulated,
        )

    def _history(self, tare: Mapping[str, float], start_s: float, cycle_s: float | None) -> History:
        feedbacks = [feedback for items in self._feedbacks.values() for feedback in items]
        watched = [  # channels that controllers want to see with every step
            channel
            for table in self._track.loops.values()
            for controller in table.controllers.values()
            for channel in watched_by(controller)
        ]
        needed = dict.fromkeys([*(c for feedback in feedbacks for c in feedback.channels), *watched])
        keep_s = max(feedback.memory_s(cycle_s) for feedback in feedbacks)
        columns = {channel: self._columns[channel] for channel in needed}
        return History(columns, tare, start_s, keep_s)
