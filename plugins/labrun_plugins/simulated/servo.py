"""What simulated servos have in common: joints of the scene, limits, and a shaft each; a plain one."""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from labrun.devices import DeviceContext, DeviceError, DeviceSettings, FloatArray, Scene, Trajectory
from labrun.models import kernel
from labrun.toml import Keys
from labrun_plugins.simulated.bench import packed, unpacked
from labrun_plugins.simulated.device import SimulatedDevice, SimulatedSettings

_SUBSTEP_S = 0.005
_NO_STEP_RAD = 1e-6


@dataclass(frozen=True, slots=True)
class Shaft:
    """A position servo with its horn and what hangs on it: a second-order closed loop of limited speed.

    Attributes
    ----------
    frame_s
        Time between two commands that the servo takes note of; a whole number of 5 ms.
    step_rad
        Quantization of the command.
    dead_band_rad
        A command that differs by no more than this from the one being followed is not taken note of.
    speed_rad_s
        Greatest speed.
    natural_hz, damping
        Natural frequency and damping ratio of the closed loop.
    smooth
        Commands come half a frame late in place of once a frame, as a model without frames has it.
    """

    frame_s: float
    step_rad: float
    dead_band_rad: float
    speed_rad_s: float
    natural_hz: float
    damping: float
    smooth: bool = False

    def smoothed(self) -> "Shaft":
        """Return a shaft of the same delay and dynamics, without frames, steps and dead band."""
        return replace(self, step_rad=_NO_STEP_RAD, dead_band_rad=0.0, smooth=True)

    def motion(
        self, joint: str, trajectory: Trajectory, from_rad: float, from_rad_s: float = 0.0
    ) -> Trajectory:
        """Return the shaft's motion for a commanded trajectory of one joint, from this angle and speed on.

        The command is sampled once a frame, quantized and held. Between two points 5 ms apart the loop
        ``x'' = w^2 (command - x) - 2 D w x'`` is solved exactly; its speed is then cut to the greatest one.
        """
        # After the last command the shaft still needs its settling time, or the way at full speed, to arrive.
        commanded = trajectory.angle_rad[:, 0]
        reach = max(float(commanded.max()) - from_rad, from_rad - float(commanded.min()))
        tail_s = 1.5 / self.natural_hz + self.frame_s + reach / self.speed_rad_s
        count = math.ceil((trajectory.duration_s + tail_s) / _SUBSTEP_S) + 1
        frame_s = _SUBSTEP_S if self.smooth else self.frame_s
        hold = round(frame_s / _SUBSTEP_S)
        frame_time_s = np.arange(-(-count // hold), dtype=np.float64) * frame_s
        command = np.interp(frame_time_s - 0.5 * (self.frame_s - frame_s), trajectory.time_s, commanded)
        angle = _follow(
            command, hold, count, from_rad, from_rad_s, transition(self.natural_hz, self.damping, _SUBSTEP_S),
            self.step_rad, self.dead_band_rad, self.speed_rad_s,
        )  # fmt: skip
        time_s = np.arange(count, dtype=np.float64) * _SUBSTEP_S
        return Trajectory((joint,), time_s, angle[:, None], trajectory.period_s)


@functools.cache
def transition(natural_hz: float, damping: float, step_s: float) -> FloatArray:
    """Return the matrix that takes error (command - x) and speed one step on, shape (2, 2)."""
    natural = 2.0 * math.pi * natural_hz
    decay = damping * natural
    damped = natural * math.sqrt(1.0 - damping**2)
    cosine, sine = math.cos(damped * step_s), math.sin(damped * step_s) / damped
    matrix = np.array([
        [cosine + decay * sine, -sine],
        [natural**2 * sine, cosine - decay * sine],
    ])  # fmt: skip
    return math.exp(-decay * step_s) * matrix


@kernel
def _follow(
    command: FloatArray, hold: int, count: int, angle_rad: float, speed_rad_s: float, transition: FloatArray,
    step_rad: float, dead_band_rad: float, most_rad_s: float,
) -> FloatArray:  # fmt: skip
    angles = np.empty(count)
    angle, speed, goal = angle_rad, speed_rad_s, angle_rad
    for i in range(count):
        angles[i] = angle
        if i % hold == 0:
            stepped = np.round(command[i // hold] / step_rad) * step_rad
            if abs(stepped - goal) > dead_band_rad:
                goal = stepped
        error = goal - angle
        next_error = transition[0, 0] * error + transition[0, 1] * speed
        speed = transition[1, 0] * error + transition[1, 1] * speed
        if abs(speed) > most_rad_s:
            speed = most_rad_s if speed > 0.0 else -most_rad_s
            next_error = error - speed * _SUBSTEP_S
        angle = goal - next_error
    return angles


_SPEED_OVER_S = 1e-3
"""A shaft that is moving when it gets another command keeps its speed, which is taken over this long."""


def require_joints(device: str, joints: Sequence[str], scene: Scene) -> None:
    """Raise DeviceError where the bench lacks a joint of the device."""
    missing = [joint for joint in joints if joint not in scene.joints]
    if missing:
        raise DeviceError(
            device,
            f"this bench has no joint {', '.join(missing)}",
            hint=f"it has {', '.join(scene.joints) or 'none'}; joints are named as in [gait.joints]",
        )


class SimulatedJoints(SimulatedDevice):
    """Drives joints of the scene through servos.

    Parameters
    ----------
    signs
        Joint -> +1 or -1: a servo with sign -1 turns its joint of the bench against the commanded sense.
    shaft
        What each servo is like.
    sensor
        What `SimulatedSensor` takes, for a servo that is one as well.
    """

    def __init__(
        self,
        name: str,
        settings: SimulatedSettings,
        context: DeviceContext,
        signs: Mapping[str, int],
        shaft: Shaft,
        **sensor: Any,
    ) -> None:
        super().__init__(name, settings, context, **sensor)
        self.joints = tuple(signs)
        self._signs = dict(signs)
        if getattr(context.scene, "smooth_drives", False):
            shaft = shaft.smoothed()
        self._shaft = shaft
        self._motion: dict[str, tuple[float, Trajectory]] = {}
        self._commanded: dict[str, tuple[float, Trajectory]] = {}

    def open(self) -> None:
        """Connect. Raises DeviceError: the bench has no joint of that name."""
        require_joints(self.name, self.joints, self.scene)
        super().open()

    def pose(self) -> Mapping[str, float]:
        """Return the last commanded angles, rad: an RC servo does not say where it is."""
        self._require_answer()
        now = self._clock.now()
        return {joint: self._angle(self._commanded, joint, now) for joint in self.joints}

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Start following at the clock's `start_s`, then hold the last point.

        Raises
        ------
        LimitExceededError
            The trajectory leaves a limit: nothing of it is sent.
        DeviceError
            Wrong joints, angles that are not numbers, or no answer.
        """
        self._require_answer()
        self._check(trajectory)
        for joint in self.joints:
            command = trajectory.only((joint,))
            motion = self._shaft.motion(joint, command, *self._state(joint, start_s))
            self._commanded[joint] = (start_s, command)
            self._move(joint, motion, start_s)

    def safe_stop(self) -> None:
        """Hold every joint where it is now."""
        self._log_stop(self.name, "safe_stop")
        if self.closed or self._scene is None:
            return
        now = self._clock.now()
        for joint in self.joints:
            if joint in self._motion:
                here = np.array([[self._angle(self._motion, joint, now)]])
                hold = Trajectory((joint,), np.zeros(1), here)
                self._commanded[joint] = (now, hold)
                self._move(joint, hold, now)

    def snapshot(self) -> dict[str, Any]:
        """Return commanded and true motions as JSON-ready values, so that a resumed run goes on identically."""
        now = self._clock.now()
        return {
            "commanded": {joint: _remembered(*move, now) for joint, move in self._commanded.items()},
            "motion": {joint: _remembered(*move, now) for joint, move in self._motion.items()},
        }

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take back what `snapshot` gave; the bench restores its own memory of the motion."""
        self._commanded = {joint: _recalled(joint, stored) for joint, stored in snapshot["commanded"].items()}
        self._motion = {joint: _recalled(joint, stored) for joint, stored in snapshot["motion"].items()}

    def _check(self, trajectory: Trajectory) -> None:
        if set(trajectory.joints) != set(self.joints):
            raise DeviceError(
                self.name,
                f"got a motion of {', '.join(trajectory.joints)}, but drives {', '.join(self.joints)}",
            )
        if not np.isfinite(trajectory.angle_rad).all():
            raise DeviceError(self.name, "got a motion with angles that are not numbers; nothing was sent")
        self._limits.require_motion(self.name, trajectory)

    def _move(self, joint: str, motion: Trajectory, start_s: float) -> None:
        self._motion[joint] = (start_s, motion)
        if self._signs[joint] == -1:
            motion = Trajectory((joint,), motion.time_s, -motion.angle_rad, motion.period_s)
        self.scene.drive(joint, motion, start_s)

    def _state(self, joint: str, time_s: float) -> tuple[float, float]:
        """Return the shaft's angle and speed at a time."""
        before, here = (self._angle(self._motion, joint, time_s - back_s) for back_s in (_SPEED_OVER_S, 0.0))
        return here, (here - before) / _SPEED_OVER_S

    @staticmethod
    def _angle(moves: Mapping[str, tuple[float, Trajectory]], joint: str, time_s: float) -> float:
        if joint not in moves:
            return 0.0
        start_s, trajectory = moves[joint]
        if time_s - start_s >= trajectory.time_s[-1]:  # at rest, as nearly always
            return float(trajectory.angle_rad[-1, 0])
        return float(np.interp(time_s - start_s, trajectory.time_s, trajectory.angle_rad[:, 0]))


def _remembered(start_s: float, trajectory: Trajectory, now_s: float) -> list[Any]:
    """Return what is left of a motion as JSON-ready values: the points passed are of no more use."""
    first = int(np.searchsorted(trajectory.time_s, now_s - start_s)) - 2
    kept = slice(min(max(first, 0), len(trajectory.time_s) - 1), None)
    return [start_s, packed(trajectory.time_s[kept]), packed(trajectory.angle_rad[kept, 0])]


def _recalled(joint: str, stored: list[Any]) -> tuple[float, Trajectory]:
    start_s, time_s, angle_rad = stored
    return start_s, Trajectory((joint,), unpacked(time_s), unpacked(angle_rad)[:, None])


def joints_or_own_name(name: str, context: DeviceContext) -> tuple[str, ...]:
    """Return the joint of a device whose table names none: the one of its name, else the only one.

    Raises DeviceError: the bench has several joints, and none is called like the device.
    """
    on_bench = () if context.scene is None else context.scene.joints
    if name in on_bench or not on_bench:
        return (name,)
    if len(on_bench) == 1:
        return tuple(on_bench)
    raise DeviceError(
        name,
        f"does not say which of the joints {', '.join(on_bench)} it drives",
        hint=f"add joints = {{ {on_bench[0]} = {{}} }} to its table, or name the device after its joint",
    )


_SHAFT = Shaft(
    frame_s=0.005, step_rad=_NO_STEP_RAD, dead_band_rad=0.0, speed_rad_s=float(np.radians(720.0)),
    natural_hz=25.0, damping=0.8,
)  # fmt: skip


class Joint(Keys):
    """One joint: a servo with sign -1 is mounted the other way round."""

    sign: Literal[-1, 1] = 1


class ServoSettings(SimulatedSettings):
    """`joints`: joint -> table; without it, the joint called like the device, or the bench's only one."""

    joints: dict[str, Joint] | None = Field(default=None, min_length=1)


class SimulatedServo(SimulatedJoints):
    """A servo better than real ones (chosen): 200 commands/s, 25 Hz, 720 deg/s, no dead band."""

    Settings: ClassVar[type[DeviceSettings]] = ServoSettings
    model = "servo (simulated)"

    def __init__(self, name: str, settings: ServoSettings, context: DeviceContext) -> None:
        if settings.joints is None:
            signs = dict.fromkeys(joints_or_own_name(name, context), 1)
        else:
            signs = {joint: int(table.sign) for joint, table in settings.joints.items()}
        super().__init__(name, settings, context, signs, _SHAFT)
