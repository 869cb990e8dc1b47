"""The recording step: motion and samples from a common start, within the limits."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from labrun.devices import Excess, Samples, Trajectory
from labrun.errors import DeviceError
from labrun.estimate import outside_text
from labrun.experiment import Condition, Experiment
from labrun.runner.bench import Bench
from labrun.runner.motion import MotionMaker, TrialMotion
from labrun.store import Role, TrialWriter

LEAD_S = 0.05
"""Time to hand every device its command before the common start."""
TAIL_S = 0.1
"""Samples of the last moment are still on their way when the motion ends."""


@dataclass
class SampleCollector:
    """Passes samples to the writer of the trial, and counts lost and invalid ones."""

    bench: Bench
    writer: TrialWriter
    samples: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    saturated: dict[str, int] = field(default_factory=dict)

    def take(self, blocks: Mapping[str, Samples]) -> None:
        """Keep one look's samples."""
        for name, block in blocks.items():
            if len(block) or block.lost:
                sensor = self.bench.rig.sensors[name]
                self.writer.append(name, sensor.channels, sensor.rate_hz, block)
            self.count(name, block)

    def count(self, name: str, block: Samples) -> None:
        """Count the samples of a device, those that were lost and those at the end of the range."""
        self.samples[name] = self.samples.get(name, 0) + len(block)
        self.lost[name] = self.lost.get(name, 0) + block.lost
        self.saturated[name] = self.saturated.get(name, 0) + block.saturated

    def fault(self, max_lost_share: float) -> str:
        """Return why the recording cannot be used; empty if it can."""
        for name, count in self.saturated.items():
            if count:
                return f"device {name}: {count} samples at the end of the measuring range"
        for name, count in self.lost.items():
            made = count + self.samples[name]
            share = count / max(made, 1)
            if share > max_lost_share:
                return (
                    f"device {name}: {count} of {made} samples were lost "
                    f"({100 * share:.2g} %, {100 * max_lost_share:.2g} % is allowed)"
                )
        return ""


@dataclass(frozen=True, slots=True)
class TrialRequest:
    """Which trial to run; `index` counts everything the run executes."""

    index: int
    condition: Condition
    repeat: int
    role: Role
    attempt: int = 0
    mounting: int | None = None


@dataclass
class TrialRecording:
    """The state of one recording.

    Attributes
    ----------
    move_speed_rad_s
        Of moves beside the motion.
    on_begin
        Told the clock's time at which the recording begins.
    command
        Returns the motion that has been sent so far; None if that is `motion`'s own.
    fault
        Why the recording cannot be used; empty if it can.
    objectives, duration_s, censored
        What a recorder knows that reduces as it goes; None where the recorded signals tell.
    stored
        Called once the trial is stored.
    remark
        Takes what the person should know of this trial.
    """

    bench: Bench
    motion: TrialMotion
    request: TrialRequest
    tare: Mapping[str, float]
    collector: SampleCollector
    on_begin: Callable[[float], object]
    command: Callable[[], Trajectory | None] = lambda: None
    fault: str = ""
    move_speed_rad_s: float = 1.0
    objectives: Mapping[str, float] | None = None
    duration_s: float | None = None
    censored: bool = False
    stored: Callable[[], object] = lambda: None
    remark: Callable[[str], object] = lambda _: None

    @property
    def condition(self) -> Condition:
        """Of the trial."""
        return self.request.condition

    def begin(self, start_s: float, command: Callable[[], Trajectory | None] | None = None) -> None:
        """Say that the first command is out, and when it starts."""
        if command is not None:
            self.command = command
        self.on_begin(start_s)

    def start_travel(self) -> None:
        """Start the carriage, if it has a part in the trial."""
        travel = self.motion.travel
        if travel is not None and travel.speed_m_s > 0:
            self.bench.travel(travel.device, travel.to_m, travel.speed_m_s, travel.acceleration_m_s2)


Recorder = Callable[[TrialRecording], None]
"""A way to record a trial: moves, waits, and hands over the samples."""


def record_planned(recording: TrialRecording) -> None:
    """Send the whole motion at once, and record from its start to its end."""
    bench, motion = recording.bench, recording.motion
    start_s = bench.clock.now() + LEAD_S
    bench.follow(motion.trajectory, start_s)
    recording.begin(start_s)
    if motion.travel is not None and motion.travel.speed_m_s > 0:
        bench.watch(start_s, recording.collector.take)
        recording.start_travel()
    bench.watch(start_s + motion.duration_s + TAIL_S, recording.collector.take)


Bounds = Mapping[str, Sequence[float]]


class _LeftError(Exception):
    """A channel has left its bounds; the text says which and where, `after` whether the motion was over by then."""

    def __init__(self, text: str, *, after: bool) -> None:
        super().__init__(text)
        self.after = after


def bounds_of(experiment: Experiment, role: str) -> Bounds:
    """Return the bounds of channels that hold in a trial: the file's, and in a search those of its guard as well."""
    bounds = dict(experiment.trial.within)
    if experiment.kind == "cmaes" and experiment.cmaes is not None and role == "measure":
        bounds |= experiment.cmaes.guard.channels
    return bounds


def within_bounds(recorder: Recorder, experiment: Experiment) -> Recorder:
    """Return a way to record that stops a trial, and rejects it, when a channel leaves its bounds.

    A trial that does is no fault of the bench: actuators stop, what was recorded is kept, and the run goes on. What
    leaves its bounds only when the motion is over is stopped as well, and the trial counts.
    """
    if not bounds_of(experiment, "measure"):
        return recorder

    def record(recording: TrialRecording) -> None:
        bounds = bounds_of(experiment, recording.request.role)
        if not bounds:
            recorder(recording)
            return
        watched = recording.collector = _Watched(recording.collector, bounds, recording.tare)
        on_begin = recording.on_begin

        def on_start(start_s: float) -> None:
            watched.ends_s = start_s + recording.motion.duration_s
            on_begin(start_s)

        recording.on_begin = on_start
        try:
            recorder(recording)
        except _LeftError as left:
            failures = recording.bench.rig.safe_stop()
            if failures:
                raise DeviceError(
                    "rig", f"{left}; not everything could be stopped: {'; '.join(failures)}"
                ) from left
            if not left.after:
                recording.fault = f"{left}: stopped"

    return record


class _Watched(SampleCollector):
    """Hands samples on, and looks at those that have bounds; `ends_s` is the clock's time at which the motion ends."""

    ends_s = np.inf

    def __init__(self, collector: SampleCollector, bounds: Bounds, tare: Mapping[str, float]) -> None:
        super().__init__(collector.bench, collector.writer)
        self._collector = collector
        self._bounds = bounds
        self._tare = tare

    def take(self, blocks: Mapping[str, Samples]) -> None:
        """Keep one look's samples, then judge them. Raises _LeftError: a channel has left its bounds."""
        self._collector.take(blocks)
        for name, (low, high) in self._bounds.items():
            device, _, channel = name.partition(".")
            block = blocks.get(device)
            if block is None or not len(block):
                continue
            channels = self.bench.rig.sensors[device].channels
            column = next(index for index, info in enumerate(channels) if info.name == channel)
            values = block.values[:, column] - self._tare.get(name, 0.0)
            left = (values < low) | (values > high)
            if left.any():
                first = int(np.argmax(left))
                raise _LeftError(
                    f"{name} = {outside_text(float(values[first]), low, high)} {channels[column].unit} is outside "
                    f"{low:g} ... {high:g}",
                    after=bool(block.host_time_s[first] > self.ends_s),
                )


def guard_excesses(experiment: Experiment, motions: MotionMaker, condition: Condition) -> list[Excess]:
    """Return violations of the guarded joint angles by a candidate's motion."""
    if experiment.cmaes is None:
        return []
    excesses = []
    trajectory = motions.motion(condition).trajectory
    for joint, (low, high) in experiment.cmaes.guard.joints_deg.items():
        angle_deg = np.degrees(trajectory.angle_rad[:, trajectory.joints.index(joint)])
        beyond = np.maximum(angle_deg - high, low - angle_deg)
        worst = int(np.argmax(beyond))
        if beyond[worst] > 1e-9:
            value = float(angle_deg[worst])
            bound = high if value > high else low
            excesses.append(
                Excess(f"guarded angle of {joint}", value, bound, "deg", float(trajectory.time_s[worst]))
            )
    return excesses
