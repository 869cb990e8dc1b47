"""The whole plan before the first move: every name, every motion against every limit, with its time and disk."""

import inspect
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labrun.devices import Excess, FloatArray, Limits
from labrun.devices.clock import SimulatedClock
from labrun.errors import ExperimentError, LabrunError, PlanError, SpecError, StoreError
from labrun.experiment import LOOP_DEVICE, CarriageMove, Condition, Experiment, Settle, condition_text
from labrun.notebook import as_reported
from labrun.objectives import TrialSignals
from labrun.runner.motion import Envelope, MotionMaker, TrialMotion, loop_notes, smooth_move
from labrun.runner.rig import Rig
from labrun.runner.settle import settle_estimate_s, watched_channels
from labrun.runner.tare import tared_devices
from labrun.store import check_columns, check_names

_ORDER_WITHOUT_RAMPS = 2
"""Parameters of a carriage's `travel` that takes goal and speed alone."""


def check_wiring(experiment: Experiment, rig: Rig, gait_joints: Iterable[str]) -> None:
    """Check every name in the file that stands for a joint, a channel or a device.

    Raises SpecError: all that the rig does not have, at once.
    """
    problems: list[str] = []
    channels = {f"{name}.{c.name}" for name, sensor in rig.sensors.items() for c in sensor.channels}
    if experiment.track is not None:
        channels |= {f"{LOOP_DEVICE}.{name}" for name in experiment.track.channels}
    problems += _unstorable(rig)
    for joint in gait_joints:
        problems += _unknown(f"gait.joints.{joint}", joint, rig.joints, "joints")
    for joint in experiment.trial.safe_pose_deg:
        problems += _unknown(f"trial.safe_pose_deg.{joint}", joint, rig.joints, "joints")
    if experiment.trial.carriage is not None:
        device = experiment.trial.carriage.device
        problems += _unknown("trial.carriage.device", device, rig.carriages, "carriages")
        problems += _ramps(experiment.trial.carriage, rig)
    for name, objective in experiment.objectives.items():
        if objective.channel is not None:
            problems += _unknown(f"objectives.{name}.channel", objective.channel, channels, "channels")
    try:
        if experiment.trial.settle is not None and experiment.trial.settle.until == "quiet":
            watched_channels(experiment.trial.settle, rig)
        tared_devices(experiment.trial.tare, rig)
    except SpecError as error:
        problems.append(str(error))
    if problems:
        raise SpecError("\n".join(problems))


def _ramps(move: CarriageMove, rig: Rig) -> list[str]:
    carriage = rig.carriages.get(move.device)
    if move.acceleration_m_s2 is None or carriage is None:
        return []
    if len(inspect.signature(carriage.travel).parameters) > _ORDER_WITHOUT_RAMPS:
        return []
    return [
        f"trial.carriage.acceleration_m_s2: {move.device!r} has ramps of its own that cannot be set; leave the key out"
    ]


def _unstorable(rig: Rig) -> list[str]:
    """Return what could not be stored under its name: better known before a trial than after it."""
    problems = []
    for name in rig.devices:
        try:
            channels = rig.sensors[name].channels if name in rig.sensors else ()
            check_names(name, [channel.name for channel in channels])
        except StoreError as error:
            problems.append(f"rig.devices.{name}: {error}")
    try:
        check_columns("joint", list(rig.joints))
    except StoreError as error:
        problems.append(str(error))
    return problems


def _unknown(key: str, name: str, known: Iterable[str], kind: str) -> list[str]:
    known = sorted(known)
    if name in known:
        return []
    return [f"{key}: {name!r} is not one of the rig's {kind}: {', '.join(known) or 'it has none'}"]


_SHOWN = 5
_TRIAL_BYTES = 40_000
"""What a trial's file takes beside its samples: groups, attributes, command, settle curve, checkpoint."""
_PACKED_SHARE = 1.1
"""What a trial takes in run.h5, as a share of its own file."""
_SAMPLE_BYTES = 8
_ADVICE = "narrow the axes, or add a where constraint that keeps these conditions out"
_LOOP_ADVICE = "narrow the range of the loop, or give it a slower slew_per_s"


@dataclass(frozen=True, slots=True)
class JointPeak:
    """The largest demand on a joint over the plan, with its limits (None if unset)."""

    joint: str
    device: str
    angle_deg: tuple[float, float]
    speed_deg_s: float
    angle_limit_deg: tuple[float, float] | None
    speed_limit_deg_s: float | None


@dataclass(frozen=True, slots=True)
class ConditionExcess:
    """What one condition would break."""

    condition: Condition
    excess: tuple[Excess, ...]


def percent(share: float) -> str:
    """Return a share as a person reads it: "84 %", "0.3 %"."""
    return f"{100 * share:.0f} %" if share >= 0.1 or share == 0.0 else f"{100 * share:.2g} %"


@dataclass(frozen=True, slots=True)
class SpaceBreak:
    """What keeps points of a search space from running: a constraint, or a limit at its worst; and how many it does."""

    what: str
    share: float

    def __str__(self) -> str:
        return f"{percent(self.share)} break: {self.what}"


@dataclass(frozen=True, slots=True)
class SearchSpace:
    """How much of a search's space may run.

    Attributes
    ----------
    points
        How many were looked at.
    share
        About this share of the space satisfies every constraint and limit.
    breaks
        What excludes the rest, the most frequent first.
    start
        What the point that the search starts from breaks; empty if it may run.
    """

    points: int
    share: float
    breaks: tuple[SpaceBreak, ...]
    start: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """What a run would do.

    Attributes
    ----------
    conditions
        How many there are; of a search, how many points of its space were looked at.
    trials, trials_at_most
        Trials with the least and the greatest number of repeats, reference trials included.
    time_s, time_at_most_s
        How long they take on the bench.
    settle_s, settle_at_most_s
        The settle times that `time_s` and `time_at_most_s` count a trial with: the least that evidence takes, and the
        timeout.
    disk_bytes
        Of `trials`, while they are packed: their files, and run.h5 beside them.
    disk_kept_bytes
        Of run.h5, all that is left afterwards.
    peaks
        Of each joint.
    rates_hz
        Sample rate of each sensor.
    excess
        Conditions that leave a limit.
    space
        Of a search, which chooses its conditions as it goes: how much of its space may run. Peaks are then those of
        the points its constraints allow.
    notes
        What is no error, but worth a word.
    advice
        What to do where conditions leave a limit.
    """

    conditions: int
    trials: int
    trials_at_most: int
    time_s: float
    time_at_most_s: float
    settle_s: float
    disk_bytes: int
    disk_kept_bytes: int
    peaks: tuple[JointPeak, ...]
    rates_hz: dict[str, float]
    excess: tuple[ConditionExcess, ...] = ()
    settle_at_most_s: float = 0.0
    space: SearchSpace | None = None
    notes: tuple[str, ...] = ()
    advice: str = _ADVICE

    def _repr_html_(self) -> str:
        return as_reported("plan_text", self, Path("results"))

    def require_feasible(self) -> None:
        """Raise PlanError if any condition leaves a limit: the first few, and how many there are."""
        if not self.excess:
            return
        lines = [
            f"  {condition_text(item.condition)}: {'; '.join(str(excess) for excess in item.excess)}"
            for item in self.excess[:_SHOWN]
        ]
        if len(self.excess) > _SHOWN:
            lines.append(f"  ... and {len(self.excess) - _SHOWN} more")
        raise PlanError(
            f"{len(self.excess)} of {self.conditions} conditions leave a limit\n" + "\n".join(lines),
            hint=self.advice,
        )

    def report(self) -> dict[str, Any]:
        """Return the plan as JSON-ready values."""
        return {
            "conditions": self.conditions,
            "trials": self.trials,
            "trials_at_most": self.trials_at_most,
            "time_s": self.time_s,
            "time_at_most_s": self.time_at_most_s,
            "settle_s_assumed": self.settle_s,
            "settle_s_at_most": self.settle_at_most_s,
            "disk_bytes": self.disk_bytes,
            "disk_kept_bytes": self.disk_kept_bytes,
            "joints": {
                peak.joint: {
                    "device": peak.device,
                    "angle_deg": list(peak.angle_deg),
                    "angle_limit_deg": None if peak.angle_limit_deg is None else list(peak.angle_limit_deg),
                    "speed_deg_s": peak.speed_deg_s,
                    "speed_limit_deg_s": peak.speed_limit_deg_s,
                }
                for peak in self.peaks
            },
            "rates_hz": self.rates_hz,
            "search_space": None if self.space is None else asdict(self.space),
            "notes": list(self.notes),
            "outside_limits": [
                {"condition": dict(item.condition), "excess": [str(excess) for excess in item.excess]}
                for item in self.excess
            ],
        }


@dataclass
class _Peaks:
    low_deg: dict[str, float] = field(default_factory=dict)
    high_deg: dict[str, float] = field(default_factory=dict)
    speed_deg_s: dict[str, float] = field(default_factory=dict)

    def take(
        self, joints: Sequence[str], low_deg: FloatArray, high_deg: FloatArray, speed_deg_s: FloatArray
    ) -> None:
        for joint, low, high, speed in zip(joints, low_deg, high_deg, speed_deg_s, strict=True):
            self.low_deg[joint] = min(self.low_deg.get(joint, math.inf), float(low))
            self.high_deg[joint] = max(self.high_deg.get(joint, -math.inf), float(high))
            self.speed_deg_s[joint] = max(self.speed_deg_s.get(joint, 0.0), float(speed))


class Planner:
    """Checks conditions of one experiment against the limits of its rig.

    Parameters
    ----------
    rig
        Its devices, not necessarily opened; without it, stand-ins tell which device moves which joint.
    motions
        Motions made so far, of the same experiment.
    """

    def __init__(
        self, experiment: Experiment, rig: Rig | None = None, motions: MotionMaker | None = None
    ) -> None:
        self._experiment = experiment
        self._rig = rig or Rig.build(experiment, clock=SimulatedClock(), seed=0, dry_run=True)
        self._motions = motions if motions is not None else MotionMaker(experiment)
        check_wiring(experiment, self._rig, self._motions.joints)

    @property
    def rig(self) -> Rig:
        """The devices that are planned with."""
        return self._rig

    def excess_of(self, condition: Condition) -> list[Excess]:
        """Return every limit a condition would leave, with its size; empty if it can be run."""
        return self._excess(self._motion(condition), self._motions.envelope(condition))

    def plan(self, conditions: Sequence[Condition], *, more_columns_hz: float = 0.0) -> Plan:
        """Check all conditions, with time and disk; nothing is connected, nothing moves.

        Parameters
        ----------
        more_columns_hz
            Values a second that are recorded beside those of the sensors.

        Returns
        -------
        Plan
            With every condition that leaves a limit; `Plan.require_feasible` makes an error of them.

        Raises
        ------
        PlanError
            There is no condition, or one that gives no motion.
        """
        if not conditions:
            raise PlanError(
                "the plan has no condition to run", hint="check the axes and the where constraints"
            )
        trial = self._experiment.trial
        peaks = _Peaks()
        broken: list[ConditionExcess] = []
        times: list[float] = []
        samples: list[float] = []
        without_cycle: list[str] = []
        for condition in conditions:
            motion = self._motion(condition)
            worst = self._motions.envelope(condition)
            course = motion.trajectory
            low, high = course.angle_rad.min(axis=0), course.angle_rad.max(axis=0)
            peaks.take(
                course.joints, np.degrees(low), np.degrees(high), np.degrees(course.peak_speed_rad_s())
            )
            if worst is not None:
                peaks.take(worst.joints, worst.low_deg, worst.high_deg, worst.speed_deg_s)
            times.append(self._trial_s(motion))
            samples.append(motion.kept_s)
            if reason := self._lacks_whole_cycle(motion, condition):
                without_cycle.append(f"{condition_text(condition)}: {reason}")
            if excess := self._excess(motion, worst):
                broken.append(ConditionExcess(condition, tuple(excess)))
        broken += self._fixed_excess()
        least, most = (self._with_references(len(times) * n) for n in (trial.repeats.min, trial.repeats.max))
        mean_s = float(np.mean(times))
        settle_s, settle_at_most_s = settle_estimate_s(trial.settle), _settle_at_most_s(trial.settle)
        slow_s = mean_s - settle_s + settle_at_most_s
        recorded_s = float(np.mean(samples))
        bytes_s = sum(s.rate_hz * _SAMPLE_BYTES * (len(s.channels) + 3) for s in self._rig.sensors.values())
        trial_bytes = _TRIAL_BYTES + (bytes_s + _SAMPLE_BYTES * more_columns_hz) * recorded_s
        return Plan(
            conditions=len(conditions),
            trials=least,
            trials_at_most=most,
            time_s=least * mean_s,
            time_at_most_s=most * slow_s,
            settle_s=settle_s,
            settle_at_most_s=settle_at_most_s,
            disk_bytes=int(least * trial_bytes * (1.0 + _PACKED_SHARE)),
            disk_kept_bytes=int(least * trial_bytes * _PACKED_SHARE),
            peaks=tuple(self._peaks(peaks)),
            rates_hz={name: sensor.rate_hz for name, sensor in self._rig.sensors.items()},
            excess=tuple(broken),
            notes=(
                *loop_notes(self._experiment.track),
                *self._unlimited(peaks),
                *_cycle_notes(without_cycle, len(conditions)),
            ),
            advice=_ADVICE if self._experiment.track is None else _LOOP_ADVICE,
        )

    def _unlimited(self, peaks: _Peaks) -> Iterable[str]:
        for device in dict.fromkeys(self._rig.joints[joint] for joint in peaks.low_deg):
            if self._rig.limits[device] == Limits():
                yield f"{device} has no limit set: whatever is asked of its joints will be commanded"

    def _lacks_whole_cycle(self, motion: TrialMotion, condition: Condition) -> str:
        """Return why no whole cycle of the recording counts; empty if one does, or no objective asks for one."""
        trial = self._experiment.trial
        if not self._experiment.objectives or motion.most_cycles is not None:
            return ""
        signals = TrialSignals(
            signals={},
            command=motion.trajectory,
            start_s=0.0,
            end_s=motion.duration_s,
            period_s=motion.period_s,
            discard_cycles=trial.discard_cycles,
            counts_from_s=motion.counts_from_s,
            condition=condition,
            average=trial.average,
            frequencies_hz=motion.frequencies_hz,
        )
        try:
            signals.window()
        except ExperimentError as error:
            return str(error.args[0])
        return ""

    def _motion(self, condition: Condition) -> TrialMotion:
        try:
            return self._motions.motion(condition)
        except LabrunError as error:
            raise PlanError(f"{condition_text(condition)}: {error}") from error

    def _excess(self, motion: TrialMotion, worst: Envelope | None) -> list[Excess]:
        excess = list(motion.excess)
        for name, actuator in self._rig.actuators.items():
            joints = tuple(joint for joint in actuator.joints if joint in motion.trajectory.joints)
            if joints and worst is not None:  # the motion itself is one of those that the loops may ask for
                excess += worst.excess(joints, self._rig.limits[name])
            elif joints:
                excess += self._rig.limits[name].trajectory_excess(motion.trajectory.only(joints))
        if motion.travel is not None:
            limits = self._rig.limits[motion.travel.device]
            excess += limits.travel_excess(motion.travel.to_m, motion.travel.speed_m_s)
        return excess

    def _fixed_excess(self) -> list[ConditionExcess]:
        """Return what every trial would break, whatever its condition: the safe pose, the carriage's way back."""
        excesses: list[Excess] = []
        trial = self._experiment.trial
        for joint, angle_deg in trial.safe_pose_deg.items():
            bounds = self._rig.limits[self._rig.joints[joint]].angle_deg
            if bounds is not None and not bounds[0] <= angle_deg <= bounds[1]:
                bound = bounds[1] if angle_deg > bounds[1] else bounds[0]
                excesses.append(Excess(f"safe pose of {joint}", angle_deg, bound, "deg", 0.0))
        if trial.carriage is not None:
            limits = self._rig.limits[trial.carriage.device]
            excesses += limits.travel_excess(float(trial.carriage.from_m), trial.carriage.return_speed_m_s)
        return [ConditionExcess({"trial": "every"}, tuple(excesses))] if excesses else []

    def _trial_s(self, motion: TrialMotion) -> float:
        """Return how long one trial takes, with moves from and to the safe pose (or zero)."""
        trial = self._experiment.trial
        safe = {
            joint: math.radians(trial.safe_pose_deg.get(joint, 0.0)) for joint in motion.trajectory.joints
        }
        ends = [
            dict(zip(motion.trajectory.joints, motion.trajectory.angle_rad[i], strict=True)) for i in (0, -1)
        ]
        moves = [smooth_move(safe, ends[0], math.radians(trial.move_speed_deg_s))]
        if trial.safe_pose_deg:
            moves.append(smooth_move(ends[1], safe, math.radians(trial.move_speed_deg_s)))
        total = motion.longest_s + sum(move.duration_s for move in moves if move is not None)
        total += settle_estimate_s(trial.settle) + (trial.tare.duration_s if trial.tare is not None else 0.0)
        if motion.travel is not None and motion.travel.speed_m_s > 0:
            total += motion.travel.speed_m_s * motion.duration_s / motion.travel.return_speed_m_s
        return total

    def _with_references(self, trials: int) -> int:
        reference = self._experiment.trial.reference
        return trials if reference is None else trials + math.ceil(trials / reference.every)

    def _peaks(self, peaks: _Peaks) -> Iterable[JointPeak]:
        for joint, low in peaks.low_deg.items():
            device = self._rig.joints[joint]
            limits = self._rig.limits[device]
            yield JointPeak(
                joint,
                device,
                (low, peaks.high_deg[joint]),
                peaks.speed_deg_s[joint],
                limits.angle_deg,
                limits.speed_deg_s,
            )


def _cycle_notes(reasons: Sequence[str], conditions: int) -> list[str]:
    """Return what to say of conditions whose recordings hold no whole cycle that counts."""
    if not reasons:
        return []
    return [
        f"{len(reasons)} of {conditions} conditions record no whole cycle of the gait that counts, and their trials "
        f"fail at an objective over whole cycles; {reasons[0]}; give trial.cycles, or a longer trial.duration_s"
    ]


def _settle_at_most_s(rule: Settle | None) -> float:
    if rule is None:
        return 0.0
    return rule.hold_s if rule.until == "time" else rule.timeout_s
