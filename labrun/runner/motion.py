"""What a condition makes the bench do in one trial: joint motion, its length, and the carriage's part."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labrun.devices import Excess, Trajectory
from labrun.errors import PlanError
from labrun.gaits import make_gait
from labrun.runner.envelope import Envelope, envelope
from labrun.spec import Condition, Experiment, condition_text
from labrun.toml import evaluate

_PEAK = 1.875
"""Peak speed of a minimum-jerk move, in mean speeds (Flash and Hogan 1985: 10 s^3 - 15 s^4 + 6 s^5)."""

_RATE_HZ = 50.0
_NEGLIGIBLE_RAD = 1e-6


def smooth_move(
    start_rad: Mapping[str, float], goal_rad: Mapping[str, float], speed_rad_s: float
) -> Trajectory | None:
    """Return a minimum-jerk move of some joints, all ending together.

    Parameters
    ----------
    start_rad, goal_rad
        Angle of each joint, rad; joints without a goal are left out.
    speed_rad_s
        Greatest speed any joint may reach.

    Returns
    -------
    Trajectory or None
        None if there is nothing to move. Between two poses inside their limits the whole move is inside: every
        joint's angle is monotone.
    """
    joints = tuple(joint for joint in goal_rad if joint in start_rad)
    start = np.array([start_rad[joint] for joint in joints])
    goal = np.array([goal_rad[joint] for joint in joints])
    farthest = float(np.max(np.abs(goal - start), initial=0.0))
    if farthest < _NEGLIGIBLE_RAD:
        return None
    # The straight pieces between points are never steeper than the curve; the margin covers rounding alone.
    duration_s = _PEAK * farthest / speed_rad_s * (1 + 1e-9)
    share = np.linspace(0.0, 1.0, max(3, math.ceil(duration_s * _RATE_HZ) + 1))
    course = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return Trajectory(joints, share * duration_s, start + course[:, None] * (goal - start))


_WHOLE = 1e-9
"""Relative slack when whole cycles are counted: 1 m at 0.1 m/s is ten cycles of 1 s, not nine."""
_MOST_NUMBERS = 4_000_000
"""Angles kept of motions made before (32 MB): a sweep of hundreds of conditions fits, one of hours a trial does not."""


@dataclass(frozen=True, slots=True)
class Travel:
    """The carriage's part: from `from_m` to `to_m` at `speed_m_s` while samples are taken."""

    device: str
    from_m: float
    to_m: float
    speed_m_s: float
    return_speed_m_s: float

    @property
    def duration_s(self) -> float:
        """How long the travel takes; infinite for a carriage that stands still."""
        return abs(self.to_m - self.from_m) / self.speed_m_s if self.speed_m_s > 0 else math.inf


@dataclass(frozen=True, slots=True)
class TrialMotion:
    """One trial's motion.

    Attributes
    ----------
    trajectory
        Of all joints of the gait, for the whole recording.
    duration_s
        Length of the recording.
    period_s
        Of one gait cycle; None if the gait has none.
    cycles
        Whole cycles recorded; None where the file gives a duration.
    travel
        None without a carriage.
    excess
        What cannot be done whatever the limits: a travel too short for the recording.
    most_cycles
        Of a trial that goes on until its numbers say so, which is sent in stretches of this motion; else None.
    """

    trajectory: Trajectory
    duration_s: float
    period_s: float | None
    cycles: int | None
    travel: Travel | None
    excess: tuple[Excess, ...] = ()
    most_cycles: int | None = None

    @property
    def longest_s(self) -> float:
        """How long the recording may take."""
        if self.most_cycles is None or self.period_s is None:
            return self.duration_s
        return self.most_cycles * self.period_s

    @property
    def kept_s(self) -> float:
        """Of how much of it the samples are kept at most."""
        if self.most_cycles is None or self.period_s is None or self.cycles is None:
            return self.duration_s
        return math.ceil(self.most_cycles / self.cycles) * self.period_s


class MotionMaker:
    """Makes the motion of each condition of an experiment, once: repeats of a condition share it."""

    def __init__(self, experiment: Experiment) -> None:
        self._made: dict[frozenset[tuple[str, float | str]], TrialMotion] = {}
        self._numbers = 0
        self._trial = experiment.trial
        self._rate_hz = experiment.gait.command_rate_hz
        self._name = experiment.gait.plugin
        self._gait = make_gait(experiment.gait)
        self._track = experiment.track
        loops = {} if experiment.track is None else experiment.track.loops
        self._start: Condition = {table.drives: table.start for table in loops.values()}

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints the gait moves."""
        return self._gait.joints

    def motion(self, condition: Condition) -> TrialMotion:
        """Return the motion of a condition.

        Raises
        ------
        PlanError
            Cycles of a gait that has no period, a carriage that stands still where its travel sets the length, or a
            gait whose angles, times or period are not finite numbers; names the gait.
        """
        key = frozenset(condition.items())
        made = self._made.get(key)
        if made is None:
            made = self._made[key] = self._make(condition)
            self._numbers += made.trajectory.angle_rad.size
            while self._numbers > _MOST_NUMBERS and len(self._made) > 1:
                self._numbers -= self._made.pop(next(iter(self._made))).trajectory.angle_rad.size
        return made

    def _make(self, condition: Condition) -> TrialMotion:
        at_start = {
            **condition,
            **self._start,
        }  # a closed loop begins with its variables there, and takes over
        period_s = self._gait.period_s(at_start)
        if period_s is not None and not 0.0 < period_s < math.inf:
            raise self._no_motion(f"its period is {period_s} s")
        travel = self._travel(condition)
        cycles, duration_s, excess = self._length(condition, period_s, travel)
        try:
            trajectory = self._gait.trajectory(at_start, duration_s=duration_s, rate_hz=self._rate_hz)
        except (ValueError, ArithmeticError) as error:
            raise self._no_motion(str(error)) from error
        most = None if self._trial.until is None else self._trial.until.max_cycles
        return TrialMotion(trajectory, duration_s, period_s, cycles, travel, excess, most)

    def envelope(self, condition: Condition) -> Envelope | None:
        """Return the worst that closed loops may make of a condition's motion; None without loops."""
        if self._track is None:
            return None
        duration_s = self.motion(condition).duration_s
        return envelope(
            self._track, self._gait, self._name, condition, duration_s=duration_s, rate_hz=self._rate_hz
        )

    def _no_motion(self, why: str) -> PlanError:
        return PlanError(
            f'gait "{self._name}" gives no motion: {why}',
            hint="look at its expressions, or keep the condition out with a where constraint",
        )

    def _travel(self, condition: Condition) -> Travel | None:
        move = self._trial.carriage
        if move is None:
            return None
        speed = float(evaluate(move.speed_m_s, _names(condition)))
        return Travel(move.device, float(move.from_m), float(move.to_m), abs(speed), move.return_speed_m_s)

    def _length(
        self, condition: Condition, period_s: float | None, travel: Travel | None
    ) -> tuple[int | None, float, tuple[Excess, ...]]:
        available_s = math.inf if travel is None else travel.duration_s
        until = self._trial.until
        wanted = self._trial.cycles if until is None else min(until.keep_every, until.max_cycles)
        if wanted is None:
            duration_s = float(self._trial.duration_s or 0.0)
            return None, duration_s, _too_long(duration_s, available_s)
        if period_s is None:
            raise PlanError(
                f"trial.{'cycles' if until is None else 'until'} needs a gait that repeats, and this one has no period",
                hint="give trial.duration_s instead, or the gait a frequency_hz",
            )
        if wanted != "fit":
            duration_s = wanted * period_s
            return wanted, duration_s, _too_long(duration_s, available_s)
        if math.isinf(available_s):
            raise PlanError(
                f'cycles = "fit" with a carriage that stands still at {condition_text(condition)}',
                hint="give a number of cycles, or the carriage a speed above zero",
            )
        cycles = math.floor(available_s / period_s * (1 + _WHOLE))
        least = self._trial.discard_cycles + 1
        if cycles < least:
            return least, least * period_s, _too_long(least * period_s, available_s)
        return cycles, cycles * period_s, ()


def _names(condition: Condition) -> Mapping[str, float | str]:
    return condition


def _too_long(duration_s: float, available_s: float) -> tuple[Excess, ...]:
    if duration_s <= available_s * (1 + _WHOLE):
        return ()
    return (Excess("recording, against the carriage's travel,", duration_s, available_s, "s", available_s),)
