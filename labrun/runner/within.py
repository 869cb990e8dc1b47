"""Bounds of channels while a trial is recorded: one that leaves them stops what moves, and ends the trial."""

from collections.abc import Mapping, Sequence

import numpy as np

from labrun.devices import Excess, Samples
from labrun.errors import DeviceError
from labrun.runner.motion import MotionMaker
from labrun.runner.recording import Recorder, SampleCollector, TrialRecording
from labrun.spec import Condition, Experiment

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

        def begun(start_s: float) -> None:
            watched.ends_s = start_s + recording.motion.duration_s
            on_begin(start_s)

        recording.on_begin = begun
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
            place = next(index for index, one in enumerate(channels) if one.name == channel)
            values = block.values[:, place] - self._tare.get(name, 0.0)
            left = (values < low) | (values > high)
            if left.any():
                first = int(np.argmax(left))
                raise _LeftError(
                    f"{name} = {values[first]:.4g} {channels[place].unit} is outside {low:g} ... {high:g}",
                    after=bool(block.host_time_s[first] > self.ends_s),
                )


def guard_excesses(experiment: Experiment, motions: MotionMaker, condition: Condition) -> list[Excess]:
    """Return what a candidate's motion would break of the joint angles that its search is guarded to."""
    if experiment.cmaes is None:
        return []
    found = []
    trajectory = motions.motion(condition).trajectory
    for joint, (low, high) in experiment.cmaes.guard.joints_deg.items():
        angle_deg = np.degrees(trajectory.angle_rad[:, trajectory.joints.index(joint)])
        beyond = np.maximum(angle_deg - high, low - angle_deg)
        worst = int(np.argmax(beyond))
        if beyond[worst] > 1e-9:
            value = float(angle_deg[worst])
            bound = high if value > high else low
            found.append(
                Excess(f"guarded angle of {joint}", value, bound, "deg", float(trajectory.time_s[worst]))
            )
    return found
