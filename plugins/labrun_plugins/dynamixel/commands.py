"""What may be sent: a motion as a whole, and each set-point right before it leaves; switching on, and stopping."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from labrun.devices import Clock, DeviceError, FloatArray, Trajectory
from labrun.errors import LimitExceededError
from labrun_plugins.dynamixel.bus import Bus
from labrun_plugins.dynamixel.control_table import (
    BUS_WATCHDOG,
    COUNT_RAD,
    GOAL_POSITION,
    MOTION,
    PRESENT_POSITION,
    PROFILE_ACCELERATION,
    PROFILE_VELOCITY,
    STOP,
    TORQUE_ENABLE,
    TRIPPED,
    TURNS,
    Scale,
    whole,
)
from labrun_plugins.dynamixel.setting_up import shut_down
from labrun_plugins.dynamixel.settings import DynamixelSettings

OVERSHOOT_RAD = float(np.radians(3.0))
"""A joint at rest may stand so far outside its limits: overshoot and play. From further out it is not moved."""
_JUMP_RAD = float(np.radians(10.0))
"""A motion from rest may begin so far from where the joint is: more would be a jump at full speed."""
SPEED_SLACK = 1.02
_WINDOW_S = 0.25
_TOLERANCE = 1e-9


class CommandCheck:
    """Knows the limits of one bus.

    Parameters
    ----------
    settings
        Its limits, operating mode and rate.
    scales
        One for each joint, in the file's order.
    """

    def __init__(self, name: str, settings: DynamixelSettings, scales: tuple[Scale, ...]) -> None:
        self._name = name
        self._limits = settings.limits
        self._period_s = 1.0 / settings.command_hz
        self._most_turns = 0.5 if settings.operating_mode == "position" else float(TURNS)
        self._scales = scales
        self._bounds = None if self._limits.angle_deg is None else np.radians(self._limits.angle_deg)
        rows = 2 * math.ceil(_WINDOW_S * settings.command_hz) + 8
        self._sent_s = np.empty(rows)
        self._sent_rad = np.empty((rows, len(scales)))
        self._first = self._end = 0

    def trajectory(self, trajectory: Trajectory, joints: tuple[str, ...]) -> Trajectory:
        """Return the motion with its columns in the order of `joints`.

        A motion that begins a little outside the angle limit, because the joint overshot, and leads back, begins at the
        limit instead.

        Raises
        ------
        LimitExceededError
            It leaves a limit.
        DeviceError
            Other joints, or beyond the reach of the operating mode.
        """
        if set(trajectory.joints) != set(joints):
            raise DeviceError(
                self._name, f"got a motion of {', '.join(trajectory.joints)}, but drives {', '.join(joints)}"
            )
        motion = self._led_back(trajectory.only(joints))
        self._limits.require_motion(self._name, motion)
        for scale, angles in zip(self._scales, motion.angle_rad.T, strict=True):
            if (
                max(scale.turns(float(angles.min())), scale.turns(float(angles.max())))
                > self._most_turns + 1e-9
            ):
                raise DeviceError(self._name, f"{self._reach()}; nothing was sent", hint=self._advice())
        return motion

    def beginning(self, joints: tuple[str, ...], first_rad: FloatArray, here_rad: FloatArray) -> None:
        """Refuse a motion from rest that does not begin where the joints are.

        Raises LimitExceededError: the first set-point would make one jump.
        """
        ways = np.abs(first_rad - here_rad)
        worst = int(np.argmax(ways))
        if not ways[worst] <= _JUMP_RAD:
            raise LimitExceededError(
                self._name,
                f"a motion of {joints[worst]} begins at {np.degrees(first_rad[worst]):.1f} deg, and it stands at "
                f"{np.degrees(here_rad[worst]):.1f} deg: it would jump; nothing was sent",
                hint="look whether it was turned by hand, or carries more than it can hold; then labrun resume",
            )

    def set_point(self, angles_rad: FloatArray, now_s: float) -> FloatArray:
        """Return a set-point that may be sent now.

        Raises LimitExceededError: it leaves the angle limit, or the way from those before is too long for the time
        since.
        """
        if not np.isfinite(angles_rad).all():
            raise LimitExceededError(
                self._name, f"a set-point of {angles_rad} rad is not a number; it was not sent"
            )
        if self._bounds is not None:
            low, high = self._bounds
            slack = _TOLERANCE * max(abs(low), abs(high))
            if (angles_rad < low - slack).any() or (angles_rad > high + slack).any():
                raise self._beyond(
                    f"set-point {np.degrees(angles_rad).round(2)} deg leaves {self._limits.angle_deg}"
                )
        if self._limits.speed_deg_s is not None:
            self._check_speed(angles_rad, now_s, self._limits.speed_deg_s)
        return angles_rad

    def forget(self) -> None:
        """Begin anew: the next set-point is the first."""
        self._first = self._end = 0

    def _check_speed(self, angles_rad: FloatArray, now_s: float, most_deg_s: float) -> None:
        """Compare the way from each of the last set-points with the time since.

        One that left late is followed by others that leave in time, so that a period more is granted each; over the
        whole window that is little.
        """
        while self._first < self._end and self._sent_s[self._first] < now_s - _WINDOW_S:
            self._first += 1
        recent = slice(self._first, self._end)
        passed_s = now_s - self._sent_s[recent]
        most_rad = SPEED_SLACK * math.radians(most_deg_s) * (passed_s + self._period_s) + COUNT_RAD
        way = np.abs(angles_rad - self._sent_rad[recent]).max(axis=1)
        beyond = way > most_rad
        if beyond.any():
            worst = int(np.argmax(beyond))
            raise self._beyond(
                f"set-point {np.degrees(way[worst]):.2f} deg from the one {1e3 * passed_s[worst]:.0f} ms before "
                f"exceeds {most_deg_s:g} deg/s"
            )
        self._keep(now_s, angles_rad)

    def _keep(self, now_s: float, angles_rad: FloatArray) -> None:
        """Remember a set-point; those that are too old to count make room."""
        if self._end == len(self._sent_s):
            kept = self._end - self._first
            if 2 * kept > len(self._sent_s):
                self._sent_s = np.concatenate([self._sent_s, np.empty_like(self._sent_s)])
                self._sent_rad = np.concatenate([self._sent_rad, np.empty_like(self._sent_rad)])
            self._sent_s[:kept] = self._sent_s[self._first : self._end].copy()
            self._sent_rad[:kept] = self._sent_rad[self._first : self._end].copy()
            self._first, self._end = 0, kept
        self._sent_s[self._end], self._sent_rad[self._end] = now_s, angles_rad
        self._end += 1

    def _led_back(self, motion: Trajectory) -> Trajectory:
        if self._bounds is None:
            return motion
        low, high = self._bounds
        angles = motion.angle_rad.copy()
        for column in angles.T:
            outside = np.maximum(column - high, low - column)
            inside = np.flatnonzero(outside <= 0.0)
            lead = int(inside[0]) if len(inside) else 0
            way = outside[:lead]
            if lead and way[0] <= OVERSHOOT_RAD and (np.diff(way) <= _TOLERANCE).all():
                column[:lead] = np.clip(column[:lead], low, high)
        return Trajectory(motion.joints, motion.time_s, angles, motion.period_s)

    def _beyond(self, what: str) -> LimitExceededError:
        return LimitExceededError(
            self._name, f"{what}; it was not sent", hint="look at the bench before labrun resume"
        )

    def _reach(self) -> str:
        if self._most_turns < 1.0:
            return "position mode covers one turn (+-180 deg)"
        return f"extended position mode covers {TURNS} turns either way"

    def _advice(self) -> str:
        advice = "set limits.angle_deg, so that the plan is refused before anything moves"
        return advice if self._most_turns > 1.0 else f'{advice}; or operating_mode = "extended-position"'


STOP_WAIT_S = 0.02
"""A stop waits no longer than this for another thread that holds the bus."""
STOP_PATIENCE_S = 0.025
"""... and no longer than this for servos to say where they are. All of it is sent twice: nobody acknowledges it."""


def goals_here(bus: Bus, scales: Mapping[int, Scale], counts: Mapping[int, int]) -> dict[int, int]:
    """Return the goals at which the joints stay where they are, id -> count, inside their limits.

    Raises DeviceError: a joint stands so far outside that it would jump back.
    """
    goals = {}
    for identity, count in counts.items():
        goals[identity] = scales[identity].inside(count)
        if abs(goals[identity] - count) * COUNT_RAD > OVERSHOOT_RAD:
            angle_deg = np.degrees(scales[identity].angle_rad(count))
            raise DeviceError(
                bus.device,
                f"{bus.who([identity])} stands at {angle_deg:.1f} deg, outside its limits; "
                "its torque stays off, because it would jump back",
                hint="turn it inside by hand, or widen limits.angle_deg",
            )
    return goals


def switch_on(bus: Bus, goals: Mapping[int, int], guarded: Sequence[int], watchdog_steps: int) -> None:
    """Give every servo its goal and its torque, then arm the watchdogs, and read back.

    Raises DeviceError: a servo does not answer, has shut down, or does not do what it was told.
    """
    ids = list(goals)
    bus.group_write(GOAL_POSITION, goals)
    bus.group_write(TORQUE_ENABLE, dict.fromkeys(ids, 1))
    for identity, status in bus.require(ids, whole(TORQUE_ENABLE)).items():
        if status.alert:
            raise shut_down(bus, identity)
        if TORQUE_ENABLE.decode(status.data) != 1:
            raise DeviceError(
                bus.device,
                f"{bus.who([identity])} does not switch its torque on",
                hint="switch its power off and on; labrun doctor --hardware reads its errors",
            )
    if not guarded:
        return
    for steps in (0, watchdog_steps):
        bus.group_write(BUS_WATCHDOG, dict.fromkeys(guarded, steps))
    for identity, status in bus.require(guarded, whole(BUS_WATCHDOG)).items():
        if BUS_WATCHDOG.decode(status.data) != watchdog_steps:
            raise DeviceError(
                bus.device,
                f"the watchdog of {bus.who([identity])} cannot be armed, or has tripped already",
                hint="raise watchdog_ms, or switch its power off and on",
            )


def check_watchdogs(bus: Bus, guarded: Sequence[int], gap_s: float) -> None:
    """After a pause that was too long, see whether servos have stopped themselves: they would not say so.

    Raises DeviceError: one has.
    """
    answers = bus.group_read(guarded, whole(BUS_WATCHDOG))
    tripped = [i for i, status in answers.items() if BUS_WATCHDOG.decode(status.data) == TRIPPED]
    if tripped:
        raise DeviceError(
            bus.device,
            f"{bus.who(tripped)} heard nothing for {1e3 * gap_s:.0f} ms and was stopped by its watchdog",
            hint="this computer was too busy: close other programs, or raise watchdog_ms",
        )


def switch_off(bus: Bus, ids: Sequence[int]) -> None:
    """Take the torque away at once, twice, and once more if one kept it; DeviceError if the port is gone."""
    off = dict.fromkeys(ids, 0)
    with bus.urgent():
        bus.group_write(TORQUE_ENABLE, off, wait_s=STOP_WAIT_S)
        bus.group_write(TORQUE_ENABLE, off, wait_s=0.0)
        answers = bus.group_read(ids, whole(TORQUE_ENABLE), wait_s=STOP_WAIT_S)
        if any(TORQUE_ENABLE.decode(status.data) for status in answers.values()):
            bus.group_write(TORQUE_ENABLE, off, wait_s=0.0)


def hold(bus: Bus, scales: Mapping[int, Scale], last_rad: FloatArray | None) -> list[int]:
    """Make the place where the joints are their goal, at once; DeviceError if the port is gone.

    As the servos' own watchdog does, it takes profiles away too, so that none stretches the way to a standstill.

    Parameters
    ----------
    last_rad : (servos,)
        The last set-point: for a servo that does not say where it is, but may hear.

    Returns
    -------
    list of int
        Servos that did not say where they are.
    """
    with bus.urgent():
        answers = bus.group_read(list(scales), MOTION, wait_s=STOP_WAIT_S, patience_s=STOP_PATIENCE_S)
        here = {i: PRESENT_POSITION.within(MOTION, status.data) for i, status in answers.items()}
        silent = [identity for identity in scales if identity not in here]
        if last_rad is not None:
            angles = dict(zip(scales, last_rad, strict=True))
            here |= {identity: scales[identity].count(float(angles[identity])) for identity in silent}
        profile = PROFILE_ACCELERATION.encode(0) + PROFILE_VELOCITY.encode(0)
        stop = {i: profile + GOAL_POSITION.encode(scales[i].inside(count)) for i, count in here.items()}
        if stop:
            bus.group_write_bytes(STOP, stop, wait_s=0.0)
            bus.group_write_bytes(STOP, stop, wait_s=0.0)
    return silent


def emergency_stop(name: str, settings: DynamixelSettings, clock: Clock) -> None:
    """Hold every joint where it is, or switch its torque off, as `on_stop` says.

    A servo that its watchdog has stopped already takes no goal, and needs none. One that does not answer is left to
    its watchdog: after this nobody talks on the bus.

    Raises
    ------
    DeviceError
        The port cannot be opened, or a servo does not answer.
    """
    scales = {table.id: Scale.of(table, settings) for table in settings.joints.values()}
    bus = Bus(
        name, settings.port, settings.baud, clock, {t.id: joint for joint, t in settings.joints.items()}
    )
    bus.open()
    try:
        if settings.on_stop == "torque-off":
            switch_off(bus, list(scales))
            bus.require(list(scales), whole(TORQUE_ENABLE))
            return
        silent = hold(bus, scales, None)
        if silent:
            bus.require(silent, MOTION)
            hold(bus, scales, None)
    finally:
        bus.close()
