"""From what a servo is told to what its shaft does."""

from dataclasses import dataclass

import numpy as np

from labrun.devices import FloatArray, Trajectory
from labrun.models.calling import kernel

_SUBSTEP_S = 0.005


@dataclass(frozen=True, slots=True)
class Shaft:
    """A position servo.

    Attributes
    ----------
    frame_s
        Time between two commands that the servo takes note of.
    step_rad
        Quantization of the command.
    dead_band_rad
        A command that differs from the position by less than this moves nothing.
    speed_rad_s
        Greatest speed.
    lag_s
        Time constant of the position loop.
    """

    frame_s: float
    step_rad: float
    dead_band_rad: float
    speed_rad_s: float
    lag_s: float

    def motion(self, joint: str, trajectory: Trajectory, from_rad: float) -> Trajectory:
        """Return the shaft's motion for a commanded trajectory of one joint, starting at `from_rad`.

        The command is sampled once a frame, quantized and held; the shaft follows with a first-order lag
        below its greatest speed, and stays put within the dead band.
        """
        # After the last command the shaft still needs its lag, or the way at full speed, to arrive.
        commanded = trajectory.angle_rad[:, 0]
        reach = float(np.max(np.abs(commanded - from_rad)))
        tail_s = 10 * self.lag_s + self.frame_s + reach / self.speed_rad_s
        count = int(np.ceil((trajectory.duration_s + tail_s) / _SUBSTEP_S)) + 1
        time_s = np.arange(count, dtype=np.float64) * _SUBSTEP_S
        frame_time_s = np.floor(time_s / self.frame_s + 1e-9) * self.frame_s
        command = np.interp(frame_time_s, trajectory.time_s, commanded)
        command = np.round(command / self.step_rad) * self.step_rad
        gain = 1.0 - np.exp(-_SUBSTEP_S / self.lag_s)
        angle = _follow(command, from_rad, gain, self.speed_rad_s * _SUBSTEP_S, self.dead_band_rad)
        return Trajectory((joint,), time_s, angle[:, None], trajectory.period_s)


@kernel
def _follow(command: FloatArray, start: float, gain: float, most: float, dead_band: float) -> FloatArray:
    angle = np.empty(len(command))
    position = start
    for i in range(len(command)):
        angle[i] = position
        error = command[i] - position
        if abs(error) > dead_band:
            step = gain * error
            position += max(-most, min(most, step))
    return angle
