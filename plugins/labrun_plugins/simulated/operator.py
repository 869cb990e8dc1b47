"""Stand-in for the person who places a body by hand and lets it go."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from labrun.devices import DeviceContext, DeviceError, DeviceSettings, Trajectory
from labrun.errors import LimitExceededError
from labrun_plugins.operator.driver import OperatorSettings
from labrun_plugins.simulated.device import SimulatedDevice, SimulatedSettings

_PLACING_SD_RAD = float(np.radians(0.25))
_HELD_S = 1e9
"""A body that is held stays held until something else is asked for."""


class SimulatedOperatorSettings(OperatorSettings, SimulatedSettings):
    """Keys of the operator, and of every simulated device."""


class SimulatedOperator(SimulatedDevice):
    """Carries a body to an angle and holds it there, or lets it go.

    A motion that goes somewhere (a preparing move) is carried out, and its end held. A motion that stays at
    one angle throughout is a release: the body is let go when the motion starts. A person places a body
    within about a quarter of a degree (standard deviation; chosen).
    """

    Settings: ClassVar[type[DeviceSettings]] = SimulatedOperatorSettings
    model = "operator (simulated)"

    def __init__(self, name: str, settings: SimulatedOperatorSettings, context: DeviceContext) -> None:
        super().__init__(name, settings, context)
        self.instruction = settings.instruction
        on_bench = () if context.scene is None else tuple(context.scene.joints)
        self.joints = on_bench[:1] or (name,)
        self._misplaced_rad = 0.0

    def reseed(self, seed: np.random.SeedSequence) -> None:
        """Take a new generator for how exactly the body is placed."""
        self._rng = np.random.default_rng(seed)

    def pose(self) -> Mapping[str, float]:
        """Where the body is, rad: it can be seen."""
        self._require_answer()
        (joint,) = self.joints
        return {joint: float(self.scene.observe((joint,), np.array([self._clock.now()]))[0, 0])}

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Carry the body along and hold it, or, for a motion that stays at one angle, let it go at `start_s`.

        Raises
        ------
        LimitExceededError
            The motion leaves a limit of the file: the person is not asked.
        DeviceError
            Another joint's motion, or angles that are not numbers.
        """
        self._require_answer()
        if trajectory.joints != self.joints:
            raise DeviceError(
                self.name,
                f"got a motion of {', '.join(trajectory.joints)}, but holds {', '.join(self.joints)}",
            )
        angle = trajectory.angle_rad[:, 0]
        if not np.isfinite(angle).all():
            raise DeviceError(self.name, "got a motion with angles that are not numbers")
        for excess in self._limits.trajectory_excess(trajectory):
            raise LimitExceededError(
                self.name, f"{excess}; the body was not moved", hint="change the condition"
            )
        if trajectory.duration_s > 0 and np.ptp(angle) == 0.0:
            self._let_go(float(angle[0]), start_s)
        else:
            self._carry(trajectory, start_s)

    def _carry(self, trajectory: Trajectory, start_s: float) -> None:
        self._misplaced_rad = _PLACING_SD_RAD * float(self._rng.standard_normal())
        share = trajectory.time_s / trajectory.duration_s if trajectory.duration_s > 0 else np.ones(1)
        angle = trajectory.angle_rad[:, 0] + share * self._misplaced_rad
        time_s = np.append(trajectory.time_s, trajectory.duration_s + _HELD_S)
        self._drive(time_s, np.append(angle, angle[-1]), start_s)

    def _let_go(self, angle_rad: float, start_s: float) -> None:
        self._drive(np.zeros(1), np.array([angle_rad + self._misplaced_rad]), start_s)

    def _drive(self, time_s: np.ndarray[Any, Any], angle_rad: np.ndarray[Any, Any], start_s: float) -> None:
        (joint,) = self.joints
        self.scene.drive(joint, Trajectory((joint,), time_s, angle_rad[:, None]), start_s)
