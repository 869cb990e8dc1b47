"""What the simulated servo devices have in common: joints of the scene, limits, and a shaft each."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices import DeviceContext, DeviceError, FloatArray, Scene, Trajectory
from labrun.errors import LimitExceededError
from labrun_plugins.simulated.bench import packed, unpacked
from labrun_plugins.simulated.device import SimulatedDevice
from labrun_plugins.simulated.settings import SimulatedSettings
from labrun_plugins.simulated.shaft import Shaft

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
    name, settings, context
        As for every device.
    signs
        Joint -> +1 or -1: a servo with sign -1 turns its joint of the bench against the commanded sense.
    shaft
        What each servo is like.
    """

    def __init__(
        self,
        name: str,
        settings: SimulatedSettings,
        context: DeviceContext,
        signs: Mapping[str, int],
        shaft: Shaft,
    ) -> None:
        super().__init__(name, settings, context)
        self.joints = tuple(signs)
        self._signs = dict(signs)
        self._shaft = shaft
        self._frame_s = shaft.frame_s
        self._motion: dict[str, tuple[float, Trajectory]] = {}
        self._commanded: dict[str, tuple[float, Trajectory]] = {}

    def open(self) -> None:
        """Connect.

        Raises
        ------
        DeviceError
            The bench has no joint of that name.
        """
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

    def compiled_joints(self, step_s: float) -> FloatArray:
        """Return the shafts' numbers; see `labrun.devices.compiled_bench.CompiledJoints`."""
        hold = max(1, round(self._frame_s / step_s))
        return np.array([self._shaft.row(step_s, hold, self._signs[joint]) for joint in self.joints])

    def joint_state(self, joint: str, time_s: float) -> tuple[float, float]:
        """Return the shaft's angle (rad) and speed (rad/s) at a time."""
        return self._state(joint, time_s)

    def moved(self, joint: str, time_s: FloatArray, angle_rad: FloatArray, goal_rad: FloatArray) -> None:
        """Take note of how a shaft moved, and of what it was told; it goes on to the last goal."""
        start_s = float(time_s[0])
        passed = time_s - start_s
        told = Trajectory((joint,), passed, goal_rad[:, None])
        self._commanded[joint] = (start_s, told)
        speed = float((angle_rad[-1] - angle_rad[-2]) / (time_s[-1] - time_s[-2]))
        last = Trajectory((joint,), np.zeros(1), goal_rad[-1:, None])
        tail = self._shaft.motion(joint, last, float(angle_rad[-1]), speed)
        motion = Trajectory(
            (joint,),
            np.concatenate([passed, passed[-1] + tail.time_s[1:]]),
            np.concatenate([angle_rad, tail.angle_rad[1:, 0]])[:, None],
        )
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

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Note the stop where `stop_log` asks for it: a simulated servo ends with its process."""
        settings.log_stop(name, "emergency_stop")

    def _check(self, trajectory: Trajectory) -> None:
        if set(trajectory.joints) != set(self.joints):
            raise DeviceError(
                self.name,
                f"got a motion of {', '.join(trajectory.joints)}, but drives {', '.join(self.joints)}",
            )
        if not np.isfinite(trajectory.angle_rad).all():
            raise DeviceError(self.name, "got a motion with angles that are not numbers; nothing was sent")
        for excess in self._limits.trajectory_excess(trajectory):
            raise LimitExceededError(
                self.name,
                f"{excess} at {excess.time_s:.3g} s of the motion; nothing was sent",
                hint="change the gait, or the device's limits in the experiment file",
            )

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

    Raises
    ------
    DeviceError
        The bench has several joints, and none is called like the device.
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
