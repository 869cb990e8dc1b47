"""What a condition makes the bench do in one trial: joint motion, length, carriage; the worst of a steered gait."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from labrun.devices import Excess, FloatArray, Limits, Trajectory
from labrun.errors import PlanError
from labrun.experiment import Condition, Experiment, Track, condition_text
from labrun.gaits import Gait, OscillatingGait, Steering, make_gait, steering_of
from labrun.toml import evaluate

_VALUES = 5
"""Values of each variable that are looked at, the bounds of its range among them."""
_POINTS = 720
"""Moments of a gait cycle that are looked at, at least."""
_STEP_S = 1e-4
"""Half the time over which a speed is taken."""
_STEP_SHARE = 1e-5
"""Share of a variable's range over which its effect on a joint is taken."""
_TOLERANCE = 1e-6
"""Relative, of the differences that stand for derivatives."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """Bounds of what joints may be commanded while loops steer them.

    Attributes
    ----------
    joints
        Their names; all arrays are of shape (joints,).
    speed_deg_s
        Greatest speed: of the gait itself at any value of the variables, and on top of it what their own greatest
        change adds at that moment.
    """

    joints: tuple[str, ...]
    low_deg: FloatArray
    high_deg: FloatArray
    speed_deg_s: FloatArray

    def excess(self, joints: tuple[str, ...], limits: Limits) -> list[Excess]:
        """Return what of a device's limits these joints may leave."""
        excess = []
        for joint in joints:
            number = self.joints.index(joint)
            if limits.angle_deg is not None:
                for value, bound, beyond in (
                    (self.low_deg[number], limits.angle_deg[0], self.low_deg[number] < limits.angle_deg[0]),
                    (self.high_deg[number], limits.angle_deg[1], self.high_deg[number] > limits.angle_deg[1]),
                ):
                    if beyond and abs(value - bound) > _TOLERANCE * max(1.0, abs(bound)):
                        excess.append(Excess(f"worst angle of {joint}", float(value), bound, "deg", 0.0))
            most = limits.speed_deg_s
            speed = float(self.speed_deg_s[number])
            if most is not None and speed > most * (1 + _TOLERANCE):
                excess.append(Excess(f"worst speed of {joint}", speed, most, "deg/s", 0.0))
        return excess


def envelope(
    track: Track, gait: Gait, plugin: str, condition: Condition, *, duration_s: float, rate_hz: float
) -> Envelope:
    """Return the worst case of a steered gait under a condition.

    Looked at are the bounds of every variable's range and values between them, in all combinations, over one cycle of
    the gait (over the whole motion, if it does not repeat or its formulas hold the time). For angles that are linear in
    the variables, as offset and amplitude are, the bounds are the worst there is.

    Parameters
    ----------
    track
        Ranges and slew rates. Without a slew rate a variable may cross its range within one step.
    gait, plugin
        The gait, and its name in the file.
    duration_s, rate_hz
        Of the motion and its points.

    Raises
    ------
    SpecError
        The gait cannot be steered.
    """
    steered = track.steered
    drives = list(steered)
    ranges = {name: (float(table.range[0]), float(table.range[1])) for name, table in steered.items()}
    rates = {
        name: table.slew_per_s or (ranges[name][1] - ranges[name][0]) * track.rate_hz
        for name, table in steered.items()
    }
    steering = steering_of(gait, plugin, condition, drives)
    start = {name: table.start for name, table in steered.items()}
    time_s = _moments(gait, {**condition, **start}, duration_s, rate_hz)
    low, high, speed = (np.full(len(gait.joints), value) for value in (np.inf, -np.inf, 0.0))
    axes = [np.linspace(bounds[0], bounds[1], _VALUES) for bounds in ranges.values()]
    for point in itertools.product(*axes):
        values = dict(zip(drives, map(float, point), strict=True))
        angle = _at(steering, time_s, values)
        low, high = np.minimum(low, angle.min(axis=0)), np.maximum(high, angle.max(axis=0))
        fastest = np.abs(
            _at(steering, time_s + _STEP_S, values) - _at(steering, time_s - _STEP_S, values)
        ) / (2 * _STEP_S)
        for name in drives:
            step = _STEP_SHARE * (ranges[name][1] - ranges[name][0])
            moved = _at(steering, time_s, {**values, name: values[name] + step})
            fastest = fastest + rates[name] * np.abs(moved - angle) / step
        speed = np.maximum(speed, fastest.max(axis=0))
    return Envelope(gait.joints, np.degrees(low), np.degrees(high), np.degrees(speed))


def loop_notes(track: Track | None) -> Iterator[str]:
    """Yield notes on the range and rate of each loop."""
    if track is None:
        return
    for name, loop in track.loops.items():
        low, high = loop.range
        slew = "anywhere in a step" if loop.slew_per_s is None else f"by at most {loop.slew_per_s:g}/s"
        yield (
            f"loop {name} sets {' and '.join(loop.drives)} to {low:g} ... {high:g} {track.rate_hz:g} times a second, "
            f"{slew}; joints are shown at the worst that the loops may ask for"
        )


def _at(steering: Steering, time_s: FloatArray, values: Mapping[str, float]) -> FloatArray:
    return steering(time_s, {name: np.full(len(time_s), value) for name, value in values.items()})


def _moments(gait: Gait, condition: Condition, duration_s: float, rate_hz: float) -> FloatArray:
    """Return the times to look at: a cycle of a gait that is the same in each, else the whole motion."""
    period_s = gait.period_s(condition)
    by_formula = "t" in getattr(gait, "names", ())
    span_s = duration_s if period_s is None or by_formula else min(period_s, duration_s)
    return np.linspace(0.0, span_s, max(_POINTS, int(span_s * rate_hz)) + 1)


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


USUAL_ACCELERATION_M_S2 = 0.5
"""Of a carriage whose file does not say: a common value for a linear move of a robot arm, and the UR5's own."""
_WHOLE = 1e-9
"""Relative slack when whole cycles are counted: 1 m at 0.1 m/s is ten cycles of 1 s, not nine."""
_LEAST_AT_SPEED_S = 0.1
"""Below that nothing is averaged out."""
_MOST_NUMBERS = 4_000_000
"""Angles kept of motions made before (32 MB): a sweep of hundreds of conditions fits, one of hours a trial does not."""


@dataclass(frozen=True, slots=True)
class Travel:
    """The carriage's part: from `from_m` to `to_m` at `speed_m_s` while samples are taken.

    It gets up to its speed and down from it at `acceleration_m_s2`; None where the file leaves that to the carriage.
    """

    device: str
    from_m: float
    to_m: float
    speed_m_s: float
    return_speed_m_s: float
    acceleration_m_s2: float | None = None
    margin_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """When the carriage begins to slow down; infinite for one that stands still."""
        return abs((self.to_m - self.from_m) / self.speed_m_s) if self.speed_m_s else math.inf

    @property
    def steady_from_s(self) -> float:
        """From when on it travels at its speed; 0 for one that stands still."""
        if self.speed_m_s <= 0:
            return 0.0
        return self.speed_m_s / (self.acceleration_m_s2 or USUAL_ACCELERATION_M_S2) + self.margin_s

    @property
    def excess(self) -> tuple[Excess, ...]:
        """Why it cannot get to its speed; empty if it can."""
        if self.speed_m_s < 0:  # which way it goes is said by from_m and to_m
            return (
                Excess("speed of the carriage (trial.carriage.speed_m_s)", self.speed_m_s, 0.0, "m/s", 0.0),
            )
        if self.speed_m_s == 0:
            return ()
        acceleration = self.acceleration_m_s2 or USUAL_ACCELERATION_M_S2
        needed_m, way_m = self.speed_m_s**2 / acceleration, abs(self.to_m - self.from_m)
        if needed_m <= way_m * (1 + _WHOLE):
            return ()
        what = (
            f"way of both ramps to {self.speed_m_s:.4g} m/s at {acceleration:.4g} m/s^2 "
            "(trial.carriage.acceleration_m_s2), against the carriage's travel,"
        )
        return (Excess(what, needed_m, way_m, "m", 0.0),)


@dataclass(frozen=True, slots=True)
class TrialMotion:
    """One trial's motion.

    Attributes
    ----------
    trajectory
        Of all joints of the gait, for the whole recording.
    period_s
        Of one gait cycle; None if the gait has none.
    cycles
        Whole cycles recorded; None where the file gives a duration.
    travel
        None without a carriage.
    excess
        What cannot be done whatever the limits: a travel too short for the recording.
    counts_from_s
        Nothing before counts: the carriage is not at its speed yet.
    most_cycles
        Of a trial that goes on until its numbers say so, which is sent in stretches of this motion; else None.
    frequencies_hz
        Of every joint that moves, where the file asks for an average over beats or over one joint's cycles.
    """

    trajectory: Trajectory
    duration_s: float
    period_s: float | None
    cycles: int | None
    travel: Travel | None
    excess: tuple[Excess, ...] = ()
    most_cycles: int | None = None
    counts_from_s: float = 0.0
    frequencies_hz: Mapping[str, float] = field(default_factory=dict)

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
        steered = {} if experiment.track is None else experiment.track.steered
        self._start: Condition = {name: table.start for name, table in steered.items()}

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
        steady_s = 0.0 if travel is None else travel.steady_from_s
        excess = (*excess, *(() if travel is None else travel.excess))
        frequencies_hz, short = self._oscillations(at_start, trajectory, duration_s - steady_s)
        excess = (*excess, *short)
        return TrialMotion(
            trajectory, duration_s, period_s, cycles, travel, excess, most, steady_s, frequencies_hz
        )

    def _oscillations(
        self, condition: Condition, trajectory: Trajectory, counts_s: float
    ) -> tuple[dict[str, float], tuple[Excess, ...]]:
        """Return the frequency of each moving joint, if requested, and whether whole cycles fit."""
        average = self._trial.average
        if average is None:
            return {}, ()
        if not isinstance(self._gait, OscillatingGait):
            raise PlanError(
                f'trial.average: the gait "{self._name}" does not state the frequencies of its joints',
                hint="give it frequencies_hz(condition), as sine has, or leave average out",
            )
        known = self._gait.frequencies_hz(condition)
        own = None if average == "beats" else average.cycles_of
        if own is not None and own not in known:
            raise PlanError(
                f"trial.average.cycles_of: the gait gives {own} no frequency",
                hint=f"it gives one to {', '.join(known) or 'no joint'}",
            )
        moves = dict(
            zip(trajectory.joints, np.ptp(trajectory.angle_rad, axis=0) > _NEGLIGIBLE_RAD, strict=True)
        )
        values = {joint: value for joint, value in known.items() if joint == own or moves.get(joint, False)}
        slowest = own if own is not None else min(values, key=lambda joint: values[joint], default=None)
        if slowest is None:
            return values, ()
        needed_s = (1 + self._trial.discard_cycles) / values[slowest]
        if needed_s <= counts_s * (1 + _WHOLE):
            return values, ()
        what = f"one cycle of {slowest} after the discarded ones, against what counts of the recording,"
        return values, (Excess(what, needed_s, max(counts_s, 0.0), "s", max(counts_s, 0.0)),)

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
            f'gait "{self._name}" computes no motion: {why}',
            hint="check its expressions, or exclude the condition with a where constraint",
        )

    def _travel(self, condition: Condition) -> Travel | None:
        move = self._trial.carriage
        if move is None:
            return None
        speed = float(evaluate(move.speed_m_s, condition))
        return Travel(
            move.device,
            float(move.from_m),
            float(move.to_m),
            speed,
            move.return_speed_m_s,
            move.acceleration_m_s2,
            move.margin_s,
        )

    def _at_speed(self, condition: Condition, travel: Travel) -> tuple[int | None, float, tuple[Excess, ...]]:
        """Return the length of a recording that ends with the carriage's constant speed."""
        if math.isinf(travel.duration_s):
            raise _still("duration_s", condition)
        ramp_s = travel.steady_from_s
        if travel.excess or travel.duration_s - ramp_s >= _LEAST_AT_SPEED_S:
            return None, travel.duration_s, ()
        needed_s = ramp_s + _LEAST_AT_SPEED_S
        what = "ramp and a moment at constant speed, against the carriage's travel,"
        return None, needed_s, (Excess(what, needed_s, travel.duration_s, "s", travel.duration_s),)

    def _length(
        self, condition: Condition, period_s: float | None, travel: Travel | None
    ) -> tuple[int | None, float, tuple[Excess, ...]]:
        available_s = math.inf if travel is None else travel.duration_s
        until = self._trial.until
        wanted = self._trial.cycles if until is None else min(until.keep_every, until.max_cycles)
        if wanted is None and self._trial.duration_s == "fit" and travel is not None:
            return self._at_speed(condition, travel)
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
            raise _still("cycles", condition)
        cycles = math.floor(available_s / period_s * (1 + _WHOLE))
        ramp_s = 0.0 if travel is None else travel.steady_from_s
        least = max(self._trial.discard_cycles, math.ceil(ramp_s / period_s - _WHOLE)) + 1
        if cycles < least:
            return least, least * period_s, _too_long(least * period_s, available_s)
        return cycles, cycles * period_s, ()


def _still(key: str, condition: Condition) -> PlanError:
    return PlanError(
        f'{key} = "fit" with a carriage that stands still at {condition_text(condition)}',
        hint=f"give {key} a number, or the carriage a speed above zero",
    )


def _too_long(duration_s: float, available_s: float) -> tuple[Excess, ...]:
    if duration_s <= available_s * (1 + _WHOLE):
        return ()
    return (Excess("recording, against the carriage's travel,", duration_s, available_s, "s", available_s),)
