"""From what a servo is told to what its shaft does."""

import functools
import math
from dataclasses import dataclass

import numpy as np

from labrun.devices import FloatArray, Trajectory
from labrun.models import kernel

_SUBSTEP_S = 0.005


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
    """

    frame_s: float
    step_rad: float
    dead_band_rad: float
    speed_rad_s: float
    natural_hz: float
    damping: float

    def row(self, step_s: float, hold: int, sign: int) -> FloatArray:
        """Return what a compiled dry run knows of it, see `labrun.devices.compiled_bench.CompiledJoints`."""
        numbers = [self.step_rad, self.dead_band_rad, self.speed_rad_s, float(hold), float(sign)]
        return np.array([*transition(self.natural_hz, self.damping, step_s).ravel(), *numbers])

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
        hold = round(self.frame_s / _SUBSTEP_S)
        frame_time_s = np.arange(-(-count // hold), dtype=np.float64) * self.frame_s
        command = np.interp(frame_time_s, trajectory.time_s, commanded)
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
            told = np.round(command[i // hold] / step_rad) * step_rad
            if abs(told - goal) > dead_band_rad:
                goal = told
        error = goal - angle
        next_error = transition[0, 0] * error + transition[0, 1] * speed
        speed = transition[1, 0] * error + transition[1, 1] * speed
        if abs(speed) > most_rad_s:
            speed = most_rad_s if speed > 0.0 else -most_rad_s
            next_error = error - speed * _SUBSTEP_S
        angle = goal - next_error
    return angles
