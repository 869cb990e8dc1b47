"""Stand-in for Dynamixel XM430 servos."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Self

import numpy as np

from labrun.devices import DeviceContext, DeviceError, DeviceSettings, FloatArray, Health, Samples, Trajectory
from labrun_plugins.dynamixel.settings import DynamixelSettings
from labrun_plugins.simulated.device import SimulatedSettings
from labrun_plugins.simulated.sensor import SimulatedSensor, Timing
from labrun_plugins.simulated.servo import Shaft, SimulatedJoints

COUNT_RAD = 2 * np.pi / 4096
SPEED_STEP_RAD_S = 0.229 * 2 * np.pi / 60
CURRENT_STEP_A = 2.69e-3
SHAFT = Shaft(
    frame_s=0.005, step_rad=COUNT_RAD, dead_band_rad=0.0, speed_rad_s=330 * SPEED_STEP_RAD_S,
    natural_hz=15.0, damping=0.8,
)  # fmt: skip
TEMPERATURE_C = 35.0
_INERTIA_KG_M2 = 1e-3
_FRICTION_N_M = 0.05
TORQUE_N_M_A = 1.8
_STEP_S = 0.005
_SUBSTEP_S = 0.005
_TIMING = Timing(latency_s=0.001, jitter_s=0.0005, clock_offset_s=12.0, clock_drift=2e-5)


class SimulatedDynamixelSettings(DynamixelSettings, SimulatedSettings):
    """Keys of the Dynamixel bus, and the bad days of a simulated device."""


def motor_current_a(speed_rad_s: FloatArray, acceleration_rad_s2: FloatArray) -> FloatArray:
    """Return what the motor draws: inertia and friction over the torque constant.

    1.8 N m/A is the stall torque of an XM430-W350 over its stall current (4.1 N m at 2.3 A); inertia of what it carries
    and friction are chosen.
    """
    friction = _FRICTION_N_M * np.tanh(speed_rad_s / 0.05)
    return np.asarray((_INERTIA_KG_M2 * acceleration_rad_s2 + friction) / TORQUE_N_M_A)


class SimulatedDynamixel(SimulatedJoints):
    """XM430-W210 in position mode: 4096 counts a turn both ways, 330 x 0.229 rev/min at most.

    Counts and velocity limit are those of the control table; commands come `command_hz` times a second, rounded to
    whole steps of 5 ms. Chosen: a closed loop of 15 Hz with damping ratio 0.8. With `feedback_hz` above zero it is a
    sensor as well.
    """

    Settings: ClassVar[type[DeviceSettings]] = SimulatedDynamixelSettings
    model = "Dynamixel XM430-W210 (simulated)"

    def __new__(cls, _name: str, settings: SimulatedDynamixelSettings, _context: DeviceContext) -> Self:
        """Make the device, as a sensor too if the file asks for a stream of measurements."""
        if cls is SimulatedDynamixel and settings.feedback_hz > 0.0:
            return object.__new__(SimulatedDynamixelWithFeedback)  # type: ignore[return-value]
        return object.__new__(cls)

    def __init__(
        self, name: str, settings: SimulatedDynamixelSettings, context: DeviceContext, **sensor: Any
    ) -> None:
        signs = {joint: int(table.sign) for joint, table in settings.joints.items()}
        frames = max(1, round(1.0 / (settings.command_hz * _SUBSTEP_S)))
        shaft = replace(SHAFT, frame_s=frames * _SUBSTEP_S)
        super().__init__(name, settings, context, signs, shaft, **sensor)
        self._turn_rad = np.pi if settings.operating_mode == "position" else 256 * 2 * np.pi
        self._neutral_rad = {j: np.radians(table.neutral_deg) for j, table in settings.joints.items()}

    def pose(self) -> Mapping[str, float]:
        """Return the measured angles, rad, in whole counts."""
        self._require_answer()
        now = self._clock.now()
        return {
            joint: round(self._angle(self._motion, joint, now) / COUNT_RAD) * COUNT_RAD
            for joint in self.joints
        }

    def health(self) -> Health:
        """Report the servos' temperature, which a simulated servo keeps at 35 degC."""
        state = super().health()
        return Health(ok=state.ok, temperature_c=TEMPERATURE_C if state.ok else None, notes=state.notes)

    def _check(self, trajectory: Trajectory) -> None:
        super()._check(trajectory)
        for joint in self.joints:
            servo_rad = self._signs[joint] * trajectory.only((joint,)).angle_rad + self._neutral_rad[joint]
            if np.abs(servo_rad).max() > self._turn_rad:
                covered = "one turn (+-180 deg)" if self._turn_rad == np.pi else "256 turns either way"
                raise DeviceError(
                    self.name,
                    f"position mode covers {covered}; nothing was sent",
                    hint="set limits.angle_deg, so that the plan is refused before anything moves",
                )


class SimulatedDynamixelWithFeedback(SimulatedDynamixel, SimulatedSensor):
    """Measures angle, speed and current of each joint between the commands; see `motor_current_a` for the last."""

    def __init__(self, name: str, settings: SimulatedDynamixelSettings, context: DeviceContext) -> None:
        channels = settings.channels()
        super().__init__(
            name, settings, context,
            channels=channels, rate_hz=settings.feedback_hz, timing=_TIMING, full_scale=np.full(len(channels), np.inf),
        )  # fmt: skip
        self._quantities = settings.feedback

    def read(self) -> Samples:
        """Return all samples since the last call. Raises DeviceError: not streaming, or no answer."""
        self._require_answer()
        return super().read()

    def _measure(self, time_s: FloatArray) -> FloatArray:
        measured = [self._measured(joint, time_s) for joint in self.joints]
        return np.column_stack([of_joint[quantity] for of_joint in measured for quantity in self._quantities])

    def _measured(self, joint: str, time_s: FloatArray) -> dict[str, FloatArray]:
        """Return what one servo measures, in steps of its registers."""
        before, here, after = (self._angles(joint, time_s + shift) for shift in (-_STEP_S, 0.0, _STEP_S))
        speed = (after - before) / (2 * _STEP_S)
        current = motor_current_a(speed, (after - 2 * here + before) / _STEP_S**2)
        return {
            "angle": np.round(here / COUNT_RAD) * COUNT_RAD,
            "speed": np.round(speed / SPEED_STEP_RAD_S) * SPEED_STEP_RAD_S,
            "current": np.round(current / CURRENT_STEP_A) * CURRENT_STEP_A,
            "load": np.round(1e3 * current / TORQUE_N_M_A) / 1e3,
        }

    def _angles(self, joint: str, time_s: FloatArray) -> FloatArray:
        if joint not in self._motion:
            return np.zeros(len(time_s))
        start_s, motion = self._motion[joint]
        return np.interp(time_s - start_s, motion.time_s, motion.angle_rad[:, 0])
