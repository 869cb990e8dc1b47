"""Stand-in for RC servos on an Arduino."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from labrun.devices import DeviceContext, DeviceError, DeviceSettings, Trajectory
from labrun_plugins.arduino_servo.settings import ArduinoServoSettings, Joint
from labrun_plugins.simulated.device import SimulatedSettings
from labrun_plugins.simulated.servo import Shaft, SimulatedJoints, joints_or_own_name

_US_PER_DEG = 10.0
_SHAFT = Shaft(
    frame_s=0.02,
    step_rad=float(np.radians(1.0 / _US_PER_DEG)),
    dead_band_rad=float(np.radians(2.0 / _US_PER_DEG)),
    speed_rad_s=float(np.radians(600.0)),
    natural_hz=6.0,
    damping=0.8,
)
_SPEED_OVER_S = 1e-3


class SimulatedArduinoServoSettings(ArduinoServoSettings, SimulatedSettings):
    """Keys of the Arduino servo, and of every simulated device."""


class SimulatedArduinoServo(SimulatedJoints):
    """RC servos: a pulse every 20 ms in steps of 1 us (0.1 deg), 500 to 2500 us, no feedback.

    Frame, pulse step and missing feedback are those of the Arduino servo library. Chosen: 10 us/deg, dead
    band 2 us, 600 deg/s (above the 528 deg/s that the source work's best caudal gait asks for), and a closed
    loop of 6 Hz with damping ratio 0.8, as of a waterproof RC servo with a fin in water on its horn.
    """

    Settings: ClassVar[type[DeviceSettings]] = SimulatedArduinoServoSettings
    model = "RC servo on Arduino (simulated)"

    def __init__(self, name: str, settings: SimulatedArduinoServoSettings, context: DeviceContext) -> None:
        tables = settings.joints or dict.fromkeys(joints_or_own_name(name, context), Joint())
        super().__init__(
            name, settings, context, {joint: int(table.sign) for joint, table in tables.items()}, _SHAFT
        )
        self._tables = dict(tables)

    def _check(self, trajectory: Trajectory) -> None:
        super()._check(trajectory)
        for joint in self.joints:
            table = self._tables[joint]
            angle_rad = trajectory.angle_rad[:, trajectory.joints.index(joint)]
            pulse_us = table.exact_pulse_us(np.degrees(angle_rad))
            low_us, high_us = table.pulse_us
            if pulse_us.min() < low_us or pulse_us.max() > high_us:
                raise DeviceError(
                    self.name,
                    f"pulses of {pulse_us.min():.0f} to {pulse_us.max():.0f} us for {joint} leave "
                    f"{low_us} to {high_us} us; nothing was sent",
                    hint="set limits.angle_deg, so that the plan is refused before anything moves",
                )


class PulsedShaft:
    """One servo's shaft, told pulse by pulse: the same shaft as the stand-in's, for an emulator.

    Parameters
    ----------
    joint
        The bench's joint it turns.
    """

    def __init__(self, joint: str) -> None:
        self.joint = joint
        # The dead band is minded here, against the pulse that is being followed.
        self._shaft = replace(_SHAFT, dead_band_rad=0.0)
        self._goal_rad: float | None = None
        self._start_s = 0.0
        self._motion: Trajectory | None = None

    def command(self, angle_rad: float, now_s: float) -> Trajectory | None:
        """Take a new command; return the shaft's motion from now on, None if the command is within the dead band."""
        if self._goal_rad is not None and abs(angle_rad - self._goal_rad) <= _SHAFT.dead_band_rad * (
            1 + 1e-9
        ):
            return None
        here, speed = self._state(now_s)
        self._goal_rad = angle_rad
        command = Trajectory((self.joint,), np.zeros(1), np.array([[angle_rad]]))
        self._motion, self._start_s = self._shaft.motion(self.joint, command, here, speed), now_s
        return self._motion

    def hold(self, now_s: float) -> Trajectory:
        """Stay where it is, as a servo without pulses does on a bench that does not push; return that motion."""
        here, _ = self._state(now_s)
        self._goal_rad = None
        self._motion = Trajectory((self.joint,), np.zeros(1), np.array([[here]]))
        self._start_s = now_s
        return self._motion

    def _state(self, now_s: float) -> tuple[float, float]:
        """Return angle (rad) and speed (rad/s)."""
        if self._motion is None:
            return 0.0, 0.0
        before, here = self._motion.at([now_s - self._start_s - _SPEED_OVER_S, now_s - self._start_s])[:, 0]
        return float(here), float(here - before) / _SPEED_OVER_S
