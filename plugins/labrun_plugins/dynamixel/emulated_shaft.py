"""The shaft of an emulated servo: the stand-in's closed loop, told goal after goal, turning a joint of the scene."""

import math
from dataclasses import replace

import numpy as np

from labrun.devices import Scene, Trajectory
from labrun_plugins.simulated.dynamixel import SHAFT, motor_current_a

_STEP_S = 0.005
_EVERY_S = 0.004
"""The scene is told of new goals no more often: it is another process, and goals may come a thousand times a second."""
_FAR_S = 20.0
"""A shaft that spins for longer than this is driven on from where it is."""


class EmulatedShaft:
    """One shaft.

    Parameters
    ----------
    joint
        Of the scene; turned by the servo's angle less `neutral_rad`.
    neutral_rad
        Servo angle at which the joint stands at zero.
    scene
        The simulated bench.
    now_s
        Time at which the shaft stands at its neutral angle.
    """

    def __init__(self, joint: str, neutral_rad: float, scene: Scene | None, now_s: float) -> None:
        self._joint = joint
        self._neutral_rad = neutral_rad
        self._scene = scene
        self._time_s = now_s
        self._angle_rad = neutral_rad
        self._speed_rad_s = 0.0
        self._goal_rad: float | None = None
        self._most_rad_s = SHAFT.speed_rad_s
        self._told_s = -math.inf
        self._untold = False
        # Compiled now, and not at the first goal: that takes seconds, in which a servo would be silent.
        SHAFT.motion(joint, Trajectory((joint,), np.zeros(1), np.zeros((1, 1))), 0.0)

    def state(self, now_s: float) -> tuple[float, float, float]:
        """Return angle (rad), speed (rad/s) and acceleration (rad/s^2) of the shaft now."""
        self._advance(now_s)
        return self._angle_rad, self._speed_rad_s, self._acceleration()

    def current_a(self, now_s: float) -> float:
        """Return what the motor draws now."""
        _, speed, acceleration = self.state(now_s)
        return float(motor_current_a(np.array(speed), np.array(acceleration)))

    def go(self, goal_rad: float, most_rad_s: float, now_s: float) -> None:
        """Turn to a goal, no faster than this."""
        if goal_rad == self._goal_rad and most_rad_s == self._most_rad_s:
            return
        self._advance(now_s)
        self._goal_rad, self._most_rad_s = goal_rad, most_rad_s
        self._untold = True
        self.tell(now_s)

    def tell(self, now_s: float) -> float:
        """Tell the scene of the newest goal, if it is time; return when to be called again."""
        if not self._untold or self._goal_rad is None:
            return math.inf
        due_s = self._told_s + _EVERY_S
        if now_s < due_s:
            return due_s
        self._advance(now_s)
        shaft = replace(SHAFT, speed_rad_s=self._most_rad_s)
        told = Trajectory((self._joint,), np.zeros(1), np.array([[self._goal_rad]]))
        self._turn(shaft.motion(self._joint, told, self._angle_rad, self._speed_rad_s), now_s)
        self._told_s = now_s
        return math.inf

    def spin(self, speed_rad_s: float, now_s: float) -> None:
        """Turn at a constant speed."""
        self._advance(now_s)
        if speed_rad_s == self._speed_rad_s and self._goal_rad is None:
            return
        self._goal_rad, self._speed_rad_s = None, speed_rad_s
        ends = np.array([[self._angle_rad], [self._angle_rad + _FAR_S * speed_rad_s]])
        self._turn(Trajectory((self._joint,), np.array([0.0, _FAR_S]), ends), now_s)

    def halt(self, now_s: float) -> None:
        """Stand still where it is."""
        self.spin(0.0, now_s)

    def _turn(self, motion: Trajectory, now_s: float) -> None:
        self._untold = False
        if self._scene is not None:
            joint = Trajectory((self._joint,), motion.time_s, motion.angle_rad - self._neutral_rad)
            self._scene.drive(self._joint, joint, now_s)

    def _advance(self, now_s: float) -> None:
        """Solve ``x'' = w^2 (goal - x) - 2 D w x'`` from the last look to now, exactly but for the cut of the speed."""
        while (left_s := now_s - self._time_s) > 0.0:
            step_s = min(left_s, _STEP_S)
            if self._goal_rad is None:
                step_s = left_s
                self._angle_rad += step_s * self._speed_rad_s
            else:
                self._step(step_s, self._goal_rad)
            self._time_s += step_s
            if step_s == left_s:
                self._time_s = now_s

    def _step(self, step_s: float, goal_rad: float) -> None:
        natural = 2.0 * math.pi * SHAFT.natural_hz
        decay = SHAFT.damping * natural
        damped = natural * math.sqrt(1.0 - SHAFT.damping**2)
        cosine, sine = math.cos(damped * step_s), math.sin(damped * step_s) / damped
        fading = math.exp(-decay * step_s)
        error, speed = goal_rad - self._angle_rad, self._speed_rad_s
        next_error = fading * ((cosine + decay * sine) * error - sine * speed)
        next_speed = fading * (natural**2 * sine * error + (cosine - decay * sine) * speed)
        if abs(next_speed) > self._most_rad_s:
            next_speed = math.copysign(self._most_rad_s, next_speed)
            next_error = error - next_speed * step_s
        self._angle_rad, self._speed_rad_s = goal_rad - next_error, next_speed

    def _acceleration(self) -> float:
        if self._goal_rad is None or abs(self._speed_rad_s) >= self._most_rad_s:
            return 0.0
        natural = 2.0 * math.pi * SHAFT.natural_hz
        error = self._goal_rad - self._angle_rad
        return natural**2 * error - 2.0 * SHAFT.damping * natural * self._speed_rad_s
